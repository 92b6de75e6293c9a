// Control: rank 0's listening sockets and the sessions behind them.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "common/wire/limits.hpp"
#include "server/net/data_plane.hpp"
#include "server/net/engine.hpp"
#include "server/net/io_loop.hpp"
#include "server/net/network.hpp"

namespace rcb::net {

struct ControlOptions {
  std::string version;
  int ranks = 1;
  bool restarted = false;  // after a crash, so that scenes may have been lost
  std::string data_dir;    // where members' last answers outlive this process; empty: nowhere
  std::string token;       // proved over TCP
  Network network = Network::loopback;
  bool files_over_tcp = false;  // clients over TCP may have the service read and write files
  std::uint64_t bulk_bytes_max = std::uint64_t{1} << 30U;
  double hello_seconds = wire::kHelloSecondsMax;
  double frame_seconds = wire::kFrameSecondsMax;
  double notice_seconds = 5;  // how often a waiting client is told what it waits for
  int sessions_max = wire::kSessionsMax;
  int orders_max = wire::kOrdersMax;
};

// A rank that has said nothing for longer than its signs of life are apart.
struct SilentRank {
  int rank;
  double seconds;
};

class Control {
 public:
  Control(IoLoop& loop, ControlOptions options, Engine& engine);
  ~Control();  // the loop must have stopped

  // Before the loop starts. Errors: those of listen_unix and listen_tcp.
  Status listen_unix(const std::string& path);
  // Gives the address as it was bound. Errors: as above.
  Result<std::string> listen_tcp(const std::string& where);
  // Before the loop starts: where clients of each endpoint find the ranks' data listeners, by rank.
  void serve_data(DataPlane& plane, const std::string& endpoint, std::vector<std::string> addresses);
  void start();
  // Now and then, once it is started: what it listens on is still there.
  void tick();
  // Before the loop starts: who knows which ranks say nothing.
  void ask_for_silence(std::function<std::vector<SilentRank>()> ask);
  // I/O thread: what a rank says of its memory.
  void memory_reported(int rank, std::uint64_t resident_bytes);
  // I/O thread: what a rank says of its slice of an open push.
  void slice_reported(int rank, const SliceReport& report);

  // Any thread: orders the end, as the command `shutdown` does.
  void shut_down(const std::string& why);
  // Not on the I/O thread, when the engines have ended: waits for the sessions to be told, then closes what is left.
  void finish(double seconds);

 private:
  struct State;
  std::shared_ptr<State> state_;
};

// Half of the machine's memory: what a push may have unless told otherwise.
std::uint64_t bulk_bytes_default();

}  // namespace rcb::net
