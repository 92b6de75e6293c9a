// Room `member`: the scene of a member of a parallel solver (client/lib/member.hpp).
//
// MemberPlaces: the rank and slot of each particle that a member of a parallel solver holds, from the answers to its
// pushes. With these a member sends each rank its particles in layout order, without ids.
//
// Invariant: while known(), these are the places after the last step; a caller that isn't sure calls forget().
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/base/buffer.hpp"

namespace rcb::client {

class MemberPlaces {
  static constexpr int kSlotBits = 40;

 public:
  static constexpr std::uint64_t kSlotsMax = std::uint64_t{1} << kSlotBits;  // of one rank

  // In ascending id.
  struct List {
    std::span<const std::int64_t> id;
    std::span<const std::int32_t> rank;
    std::span<const std::uint64_t> slot;
  };

  bool known() const { return known_; }
  void forget() { *this = MemberPlaces(); }
  // All particles that the member holds from now on. ranks: number of the service's ranks.
  void take_all(const List& all, int ranks);
  // Applies what a step changed: the ids that left, ascending, and the new places of others, which may have entered. To
  // be called once after each rows() that succeeded.
  void change(std::span<const std::int64_t> left, const List& placed);

  // For each rank, the rows (indices into `ids`) of its particles in ascending slots. Null if `ids` aren't exactly
  // those held here, or are 2^32 - 1 or more. Valid until the next call. Cost: a few passes over the ids; only rows
  // whose order differs from the last call for other reasons than particles that left or entered are sorted.
  const std::vector<std::vector<std::uint64_t>>* rows(std::span<const std::int64_t> ids);

  // Some particles of a rank, in ascending slots.
  struct Few {
    std::vector<std::uint64_t> rows;
    std::vector<std::uint64_t> slots;
  };
  // These rows of the last call of rows(), by rank.
  std::vector<Few> select(std::span<const std::uint64_t> rows) const;

 private:
  using Place = std::uint64_t;  // rank and slot in one number

  struct Pool {
    std::vector<std::int64_t> id;
    std::vector<Place> place;
  };
  static Place place_of(std::int32_t rank, std::uint64_t slot);
  bool may_have_changed(std::int64_t id) const {
    return may_have_changed_[static_cast<std::size_t>(id) % kTouched] != 0;
  }
  bool align(std::span<const std::int64_t> ids);
  bool match(std::span<const std::int64_t> ids, std::span<const std::uint32_t> open, const Pool& pool);
  void list_by_rank();

  static constexpr std::size_t kTouched = std::size_t{1} << 16U;

  bool known_ = false;
  std::vector<std::int64_t> ids_;  // by row, as given last
  std::vector<Place> places_;
  // Changes since then:
  std::vector<std::int64_t> left_;              // ascending
  Pool placed_;                                 // ascending id
  std::vector<std::uint8_t> may_have_changed_;  // by id modulo kTouched; 0: no such id has left or was placed

  std::vector<Place> next_;                         // of the ids given in the current call
  std::vector<std::vector<std::uint32_t>> row_at_;  // by rank and slot
  std::vector<std::vector<std::uint64_t>> rows_;
};

// The permutation that sorts the keys (all >= 0) stably: a radix sort, one pass for each 11 bits in which they differ.
Buffer<std::uint32_t> ascending(std::span<const std::int64_t> keys);

}  // namespace rcb::client
