// DataPath: the connections to the ranks' own listeners; sends the slices of a push on all of them at once.
//
// Invariants
// 1. Data that lies contiguously in the caller's memory, in the order to be sent, is sent from there. Everything else
//    is gathered, a frame of about 1 MiB at a time for each rank, which is written while it is in the cache.
// 2. No rank waits for another: a socket that is full is skipped until it has room.
// 3. Only whole frames are sent; once the service has answered early, no further frame is begun.
#pragma once

#include <functional>
#include <memory>
#include <vector>

#include "client/lib/connect/connection.hpp"
#include "client/lib/session/push_source.hpp"

namespace rcb::client {

class DataPath {
 public:
  // links: one connection for each rank, in order, after hello.
  explicit DataPath(std::vector<std::unique_ptr<Connection>> links);
  ~DataPath();

  // Whether all ranks have kept their connections open.
  bool stands();
  Connection& connection(int rank);
  // slice: the fields of every push.slice except rank, first, count and arrays. answered: polled, true once the service
  // has answered. Errors: unavailable, deadline_exceeded; the path can't be used after that.
  Status send(const wire::Json& slice, std::uint64_t request, const RankRows& rows, std::span<const Column> columns,
              const std::function<bool()>& answered, const Deadline& deadline);

 private:
  struct Link;
  Status send_some(Link& link, bool& moved);
  std::vector<std::unique_ptr<Link>> links_;
};

}  // namespace rcb::client
