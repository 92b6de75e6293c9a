// DataPath: the connections to the ranks' own listeners, and the slices of a push on all of them at once.
//
// Invariants
// 1. A stretch of a column that lies in the caller's memory as it is to be sent is written from there; only the others
//    are gathered, a frame of about 1 MiB at a time for each rank, which is written while it is in the cache.
// 2. No rank waits for another: a socket that is full is left alone until it has room.
// 3. Frames are always whole; when the service has answered early, the frames not yet begun are left out.
#pragma once

#include <functional>
#include <memory>
#include <vector>

#include "client/lib/connection.hpp"
#include "client/lib/push_source.hpp"
#include "common/plan/plan.hpp"

namespace rcb::client {

// Smaller pushes are one write to the endpoint; the ranks need not be told of them.
inline constexpr std::size_t kDirectBytesMin = std::size_t{1} << 18U;

class DataPath {
 public:
  // One connection a rank, said hello to, in the order of the ranks.
  explicit DataPath(std::vector<std::unique_ptr<Connection>> links);
  ~DataPath();

  // True while no rank has closed its connection.
  bool stands();
  // slice: what every push.slice says, without rank, first, count and arrays. answered: asked now and then.
  // A column with `by_rank` holds the ranks' particles in the order they are sent; the others are picked by the rows.
  // Errors: unavailable, deadline_exceeded; the path is then of no use any more.
  Status send(const wire::Json& slice, std::uint64_t request, const RankRows& rows, std::span<const Column> columns,
              const std::function<bool()>& answered, const Deadline& deadline);

 private:
  struct Link;
  Status send_some(Link& link, bool& moved);
  std::vector<std::unique_ptr<Link>> links_;
};

}  // namespace rcb::client
