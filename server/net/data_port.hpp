// DataPort: one rank's own listeners, where clients bring it its slices of direct pushes, straight into the memory that
// the engine takes over.
//
// Invariants
// 1. A slice is received for a push that the coordinator has opened, from one connection, in order of its slots. What
//    belongs to another, unknown or ended push is read and dropped; a slice that comes before its push is opened waits
//    unread, for a minute at most.
// 2. Memory is taken at a push's opening, of the size that the coordinator has admitted; pages come with the bytes.
// 3. An opened push ends in one report: whole, or why not. Before it others tell how much has come.
// Everything but recycle() runs on the I/O thread.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/base/status.hpp"
#include "common/wire/limits.hpp"
#include "server/net/data_plane.hpp"
#include "server/net/io_loop.hpp"

namespace rcb::net {

struct DataOptions {
  int rank = 0;
  std::string token;  // proved over TCP
  std::uint64_t bulk_bytes_max = std::uint64_t{1} << 30U;
  double hello_seconds = wire::kHelloSecondsMax;
  double frame_seconds = wire::kFrameSecondsMax;
  double unknown_seconds = wire::kDeadlineSecondsDefault;  // how long a slice waits for its push to be opened
  int connections_max = wire::kSessionsMax;
};

class DataPort {
 public:
  using Report = std::function<void(const SliceReport& report)>;

  // Who sees the slice of such a push, asked for when its first bytes are there; may be nobody (null).
  using Watch = std::function<std::shared_ptr<SliceObserver>(const PushTerms& terms)>;

  DataPort(IoLoop& loop, DataOptions options);
  ~DataPort();  // the loop must have stopped

  // Before the loop starts. Errors: those of listen_unix and listen_tcp.
  Status listen_unix(const std::string& path);
  // The address as it was bound. On the interface of an endpoint, which the owner has chosen.
  Result<std::string> listen_tcp(const std::string& where);
  void start(Report report, Watch watch = {});
  // Closes the listeners and the connections, removes the socket.
  void finish();

  void open(PushTicket ticket);
  void drop(const PushId& id);
  // Every kTickSeconds: tells how much has come of slices that aren't whole.
  void tick();
  // The slice of an order; empty if there is none.
  std::vector<Slice> take(std::uint64_t number);

  // Any thread. Memory for the scene's next slice instead of what is kept for it; none: nothing is kept.
  void recycle(const std::string& scene, std::vector<Buffer<std::byte>> buffers);

 private:
  struct State;
  std::shared_ptr<State> state_;
};

}  // namespace rcb::net
