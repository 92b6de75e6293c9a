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
  static constexpr int kSlotBits = 40;

 public:
  static constexpr std::uint64_t kSlotsMax = std::uint64_t{1} << kSlotBits;  // of a rank

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
  // What a step changed: the ids that left, ascending, and the new places of others, some of which were not there
  // before. Once after each rows() that gave any.
  void change(std::span<const std::int64_t> left, const List& placed);

  // For each rank the rows, by which `ids` are given, of its particles in ascending slots. Null where the ids aren't
  // exactly those that are held here, or 2^32 - 1 or more. Valid until the next call.
  // Cost: few passes; what stands in another order than at the last call, but for what left or came, is sorted.
  const std::vector<std::vector<std::uint64_t>>* rows(std::span<const std::int64_t> ids);

 private:
  using Place = std::uint64_t;  // a rank and a slot as one number

  struct Pool {
    std::vector<std::int64_t> id;
    std::vector<Place> place;
  };
  static Place place_of(std::int32_t rank, std::uint64_t slot);
  bool may_have_changed(std::int64_t id) const { return touched_[static_cast<std::size_t>(id) % kTouched] != 0; }
  bool align(std::span<const std::int64_t> ids);
  bool match(std::span<const std::int64_t> ids, std::span<const std::uint32_t> open, const Pool& pool);
  void list_by_rank();

  static constexpr std::size_t kTouched = std::size_t{1} << 16U;

  bool known_ = false;
  std::vector<std::int64_t> ids_;  // by row, as they were given last
  std::vector<Place> places_;
  // Since then:
  std::vector<std::int64_t> left_;     // ascending
  Pool placed_;                        // ascending id
  std::vector<std::uint8_t> touched_;  // 0: no id of this remainder has left or was placed

  std::vector<Place> next_;                         // of the ids given now
  std::vector<std::vector<std::uint32_t>> row_at_;  // by rank and slot
  std::vector<std::vector<std::uint64_t>> rows_;
};

// The order that sorts the keys, all >= 0, stably. Cost: a pass for each 11 bits in which they differ.
Buffer<std::uint32_t> ascending(std::span<const std::int64_t> keys);

}  // namespace rcb::client
