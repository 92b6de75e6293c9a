// Room `data`: how a rank receives its slices from clients.
//
// DataPort: one rank's own listeners. Over these, clients send the rank its slices, which
// are read straight into the memory that the engine takes over; and clients on this host hand over memory that they
// share with the rank, from which later pushes are read.
//
// Invariants (more stand with the parts: incoming_slices.hpp, shared_memories.hpp)
// 1. A slice is received only for a push that the coordinator has opened, from one connection, in order of its rows.
//    Slices of another, unknown or ended push are read and dropped; a slice that comes before its push is opened stays
//    unread for at most `unknown_seconds`.
// Everything runs on the I/O thread.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/base/status.hpp"
#include "common/files/shared_memory.hpp"
#include "common/wire/limits.hpp"
#include "server/api/spare_memory.hpp"
#include "server/net/push/data_plane.hpp"
#include "server/net/sockets/credentials.hpp"
#include "server/net/sockets/io_loop.hpp"

namespace rcb::net {

struct DataOptions {
  int rank = 0;
  Credentials credentials;  // for clients over TCP
  std::uint64_t bulk_bytes_max = std::uint64_t{1} << 30U;
  double hello_seconds = wire::kHelloSecondsMax;
  double frame_seconds = wire::kFrameSecondsMax;
  double unknown_seconds = wire::kDeadlineSecondsDefault;  // how long a slice waits for its push to be opened
  int connections_max = wire::kSessionsMax;
  std::size_t waiting_max = wire::kBeforeHelloMax;  // connections to a listener before their hello
  std::shared_ptr<api::SpareMemory> spare = std::make_shared<api::SpareMemory>();  // which slices are received into
};

class DataPort {
 public:
  using Report = std::function<void(const SliceReport& report)>;

  DataPort(IoLoop& loop, DataOptions options);
  ~DataPort();  // the loop must have stopped

  // Before the loop starts. Errors: those of listen_unix and listen_tcp.
  Status listen_unix(const std::string& path);
  // Returns the address that was bound.
  Result<std::string> listen_tcp(const std::string& where);
  void start(Report report);
  // Closes listeners and connections and removes the socket.
  void finish();

  void open(PushTicket ticket);
  void drop(const PushId& id);
  // To be called every kTickSeconds: reports how many bytes of incomplete slices have come.
  void tick();
  // The slice of the order's push, if there is any.
  std::optional<Slice> take(std::uint64_t number);
  // The memory that a session shares under this number; null if there is none.
  std::shared_ptr<const SharedMemory> memory(const std::string& session, std::int64_t number) const;
  int rank() const;

 private:
  struct State;
  std::shared_ptr<State> state_;
};

}  // namespace rcb::net
