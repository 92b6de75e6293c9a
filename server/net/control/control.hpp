// Room `control`: sessions, the order of commands, the queue at each scene, the seats of a scene. All of it runs on
// rank 0's I/O thread.
//
// Control: rank 0's listening sockets and the sessions of the clients that connect to them.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "common/wire/limits.hpp"
#include "server/net/peers/host.hpp"
#include "server/net/peers/silent_rank.hpp"
#include "server/net/push/data_plane.hpp"
#include "server/net/push/engine.hpp"
#include "server/net/sockets/credentials.hpp"
#include "server/net/sockets/io_loop.hpp"
#include "server/scene/ledger.hpp"

namespace rcb::net {

struct ControlOptions {
  std::string version;
  int ranks = 1;
  std::vector<RankHost> hosts = {};  // by rank; empty: not known
  bool restarted = false;            // after a crash
  std::string data_dir;
  Credentials credentials;      // for clients over TCP
  bool files_over_tcp = false;  // clients over TCP may have the service read and write files
  std::uint64_t bulk_bytes_max = std::uint64_t{1} << 30U;
  double hello_seconds = wire::kHelloSecondsMax;
  double frame_seconds = wire::kFrameSecondsMax;
  double notice_seconds = 5;  // how often a waiting client is told what it waits for
  int sessions_max = wire::kSessionsMax;
  std::size_t waiting_max = wire::kBeforeHelloMax;  // connections to a listener before their hello
  int orders_max = wire::kOrdersMax;
  scene::Keeping keeping = {};  // what of the scenes lasts
  // Called once, on the thread for files, when the service has been told to end; owns what it touches. May be empty.
  std::function<void()> told_to_end = {};
};

class Control {
 public:
  Control(IoLoop& loop, ControlOptions options, Engine& engine);
  ~Control();  // the loop must have stopped

  // Before the loop starts. Errors: those of listen_unix and listen_tcp.
  Status listen_unix(const std::string& path);
  // Returns the address that was bound. Errors: as above.
  Result<std::string> listen_tcp(const std::string& where);
  // Before the loop starts: the addresses, by rank, at which clients of `endpoint` find the ranks' data listeners.
  void serve_data(DataPlane& plane, const std::string& endpoint, std::vector<std::string> addresses);
  // Before the loop starts: by rank.
  void serve_this_machine(std::vector<LocalAddress> addresses);
  void start();
  // To be called periodically after start(): makes the Unix socket anew if somebody has removed it.
  void tick();
  // Before the loop starts: `ask` returns the ranks that have gone silent.
  void set_silence_query(std::function<std::vector<SilentRank>()> ask);
  // I/O thread: a rank reports its resident memory.
  void memory_reported(int rank, std::uint64_t resident_bytes);
  // I/O thread: a rank reports the state of its slice of an open push.
  void slice_reported(int rank, const SliceReport& report);

  // Any thread: orders the end of the service, as the command `shutdown` does.
  void shut_down(const std::string& why);
  // Not on the I/O thread, after the engines have ended: waits up to `seconds` until all sessions have said goodbye,
  // then closes what is left.
  void finish(double seconds);

 private:
  struct State;
  std::shared_ptr<State> state_;
};

// Half of the machine's memory: the default limit for the arrays of all pushes together.
std::uint64_t bulk_bytes_default();

}  // namespace rcb::net
