// MemberPlaces: the rank and slot of each particle that a member of a parallel solver holds, as the answers to its
// pushes tell. With them it sends the ranks its particles in the plan's order, without ids.
//
// Invariant: while known(), these are the places after the last step; whoever doubts it forgets them.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/base/buffer.hpp"

namespace rcb::client {

class MemberPlaces {
 public:
  // Particles in ascending id.
  struct List {
    std::span<const std::int64_t> id;
    std::span<const std::int32_t> rank;
    std::span<const std::uint64_t> slot;
  };

  bool known() const { return known_; }
  void forget() { *this = MemberPlaces(); }
  // All particles that the member holds from now on. ranks: of the service.
  void take_all(const List& all, int ranks);
  // What a step changed: those that left, and the new places of others, some of which were not there before.
  void change(std::span<const std::int64_t> left, const List& placed);

  // For each rank the rows, by which `ids` are given, of its particles in ascending slots. Null where the ids aren't
  // exactly those that are held here. Valid until the next call.
  // Cost: a sort of the ids unless they are those of the last call; one of the places after they changed.
  const std::vector<std::vector<std::uint64_t>>* rows(std::span<const std::int64_t> ids);

 private:
  void order_places();

  bool known_ = false;
  Buffer<std::int64_t> id_;  // ascending
  Buffer<std::int32_t> rank_;
  Buffer<std::uint64_t> slot_;
  std::vector<std::vector<std::uint32_t>> order_;  // by rank: which of the above, in ascending slots
  bool ordered_ = false;
  Buffer<std::int64_t> ids_;         // as they were given last
  Buffer<std::uint32_t> row_by_id_;  // their rows in ascending id
  std::vector<std::vector<std::uint64_t>> rows_;
};

// The order that sorts the keys, all >= 0, stably. Cost: a pass for each 11 bits in which they differ.
Buffer<std::uint32_t> ascending(std::span<const std::int64_t> keys);

}  // namespace rcb::client
