// SharedMemories: the memory that clients on this host share with a rank, by session and number.
//
// Invariants
// 1. A number stands for one memory as long as its connection lasts, so that a push never takes some ranks' values from
//    one and others' from the next.
// 2. A memory is kept as long as the connection that brought it, and as long as somebody holds what find() returned.
// Everything runs on the I/O thread.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <utility>

#include "common/base/status.hpp"
#include "common/files/shared_memory.hpp"
#include "server/net/sockets/connection.hpp"

namespace rcb::net {

class SharedMemories {
 public:
  // bytes_max: of one memory.
  SharedMemories(int rank, std::uint64_t bytes_max) : rank_(rank), bytes_max_(bytes_max) {}

  // Carries out memory.share, or else memory.drop, and answers. An error ends the connection.
  Status take_frame(Connection& connection, const Frame& frame, const std::string& session, bool share);
  // This connection has gone.
  void forget(const Connection& connection);
  // Null if there is none.
  std::shared_ptr<const SharedMemory> find(const std::string& session, std::int64_t number) const;

 private:
  using Key = std::pair<std::string, std::int64_t>;  // session and number
  struct Shared {
    std::shared_ptr<const SharedMemory> memory;
    const Connection* connection = nullptr;
  };

  // Errors: too_large, busy, invalid_argument, already_exists, and those of SharedMemory::map.
  Status share(const Key& key, std::uint64_t bytes, Descriptor descriptor, const Connection& connection);
  void drop(const Key& key, const Connection& connection);
  std::uint64_t bytes() const;

  int rank_;
  std::uint64_t bytes_max_;
  std::map<Key, Shared> memories_;
  std::map<const Connection*, std::int64_t> last_dropped_;  // the greatest number of a memory that it has dropped
};

}  // namespace rcb::net
