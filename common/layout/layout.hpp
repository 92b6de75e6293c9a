// Room `layout`: which rank holds which particle in which slot. Clients keep the same layout, so its rules are part of
// the protocol ("plan" is its name there).
//
// Layout: the layout of all ranks. Client and service derive the same next layout from the changes of a step alone; the
// rules and the checksum are stated in common/wire/PROTOCOL.md, section "The plan".
//
// Invariants
// 1. Rank r holds its particles in slots 0..count-1; after a full change they are in ascending id.
// 2. The layout before the first partition is blocks of rows: rank r has rows [floor(r n/R), floor((r+1) n/R)).
// 3. version rises with every commit that moved a particle between ranks, inserted or removed one; checksum is the sum
//    (mod 2^64) of place_mix(id, rank, slot) over all particles, so it can be updated from the changed places alone.
#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <boost/unordered/unordered_flat_map.hpp>

#include "common/base/buffer.hpp"
#include "common/base/status.hpp"
#include "common/particles/particle_set.hpp"

namespace rcb::layout {

using particles::Id;

// The parts that rank r of `ranks` owns: [part_begin(r), part_begin(r + 1)).
std::int64_t part_begin(int rank, int parts, int ranks);
struct PartRange {
  int begin = 0;
  int end = 0;

  bool has(int part) const { return part >= begin && part < end; }
};
PartRange parts_of_rank(int rank, int parts, int ranks);
int rank_of_part(int part, int parts, int ranks);
// The rows of rank r before the first partition: [row_begin(r), row_begin(r + 1)).
std::uint64_t row_begin(int rank, std::uint64_t count, int ranks);

std::uint64_t place_mix(Id id, int rank, std::uint64_t slot);
// One rank's term of the checksum, from its ids in slot order.
std::uint64_t checksum_of_rank(int rank, std::span<const Id> slot_ids);

// True for a change so large that all ranks go back to ascending id instead of filling holes.
bool is_full_change(std::uint64_t rank_changes, std::uint64_t count);

// What one rank does with its arrays when particles leave and arrive (not used for a full change).
struct SlotMove {
  std::uint64_t to;
  std::uint64_t from;  // arrival index if `arrival`, else a slot >= new_count
  bool arrival;
};
struct SlotEdit {
  std::uint64_t new_count = 0;
  std::vector<SlotMove> moves;  // no source slot is also a destination, so their order does not matter
};
// leaving: ascending slots < count; arrivals are numbered from 0 in ascending id. Cost: O(leaving + arrivals).
SlotEdit edit_of_rank(std::uint64_t count, std::span<const std::uint64_t> leaving, std::uint64_t arrivals);

// Applies an edit to one array of the rank (an axis, the ids, the weights).
template <typename T>
void apply_edit(const SlotEdit& edit, Buffer<T>& slots, std::span<const T> arrived) {
  slots.resize(std::max<std::size_t>(slots.size(), edit.new_count));
  for (const SlotMove& move : edit.moves) slots[move.to] = move.arrival ? arrived[move.from] : slots[move.from];
  slots.resize(edit.new_count);
}

// What the edit adds (mod 2^64) to the checksum. slot_ids: before the edit; arrived: ascending ids.
std::uint64_t checksum_change(const SlotEdit& edit, int rank, std::span<const Id> slot_ids,
                              std::span<const std::uint64_t> leaving, std::span<const Id> arrived);

// The whole layout, as the client holds it.
class Layout {
 public:
  // The layout before the first partition: blocks of rows. ids: by row; empty: id = row. They are the solver's,
  // distinct and >= 0, which the service checks at the first push.
  static Layout blocks(std::uint64_t count, int ranks, std::span<const Id> ids);
  // The layout received from the service as ids in slot order, rank after rank.
  // Errors: protocol_error where they aren't exactly the solver's ids.
  static Result<Layout> full(const std::vector<std::uint64_t>& rank_counts, std::span<const Id> slot_ids,
                             std::span<const Id> ids, std::uint64_t version);

  int ranks() const { return static_cast<int>(rows_.size()); }
  std::uint64_t count() const { return count_; }
  std::uint64_t version() const { return version_; }
  std::uint64_t checksum() const { return checksum_; }
  // Another one for each layout that blocks() or full() has made in this process: with version() it tells whether
  // rows() are still the same.
  std::uint64_t number() const { return number_; }
  // The rows (of the solver's arrays) that rank r holds, in slot order.
  std::span<const std::uint64_t> rows(int rank) const { return rows_[static_cast<std::size_t>(rank)]; }
  int rank_of_row(std::uint64_t row) const { return rank_of_row_[row]; }
  Id id_of_row(std::uint64_t row) const { return ids_.empty() ? static_cast<Id>(row) : ids_[row]; }
  std::uint64_t slot_of_row(std::uint64_t row) const { return slot_of_row_[row]; }
  // The ids by row; empty: id = row.
  std::span<const Id> ids() const { return ids_; }
  // The row of this id. O(log n); O(1) where ids are rows or once edit() has built its index.
  std::optional<std::uint64_t> row_of_id(Id id) const;

  // Makes the next layout from rows and their ranks after the commit (any order; rows whose rank stays are ignored).
  // first: the scene's first partition (always a full change).
  // Errors: protocol_error for a row or rank out of range or a row named twice; the layout is then unchanged.
  // Cost: O(m log m) for m changes; O(n) for a full change.
  Status apply(std::span<const std::uint64_t> changed_rows, std::span<const std::int32_t> new_ranks, bool first);

  // Applies a commit's removals and insertions, before its changes of rank. removed_rows: ascending, distinct;
  // inserted_ids and inserted_ranks (their owners): in the order given. Returns how rows change, by the same rule as a
  // rank's slots: inserted particles take the removed rows in the order given, further ones are appended.
  // Errors: protocol_error for rows or ranks out of range and ids that are there already; the layout is then unchanged.
  // Cost: O(m log m) for m of them; at the first edit O(n) for an index of the ids.
  Result<SlotEdit> edit(std::span<const std::uint64_t> removed_rows, std::span<const Id> inserted_ids,
                        std::span<const std::int32_t> inserted_ranks);

 private:
  struct Change {
    std::uint64_t row;
    std::int32_t to;
  };

  Layout(std::uint64_t count, int ranks, std::span<const Id> ids);
  static Status broken(const std::string& what);
  void put(std::uint64_t row, int rank, std::uint64_t slot);
  void sort_rows();
  Status check_edit(std::span<const std::uint64_t> removed_rows, std::span<const Id> inserted_ids,
                    std::span<const std::int32_t> inserted_ranks) const;
  void edit_ids(const SlotEdit& rows, std::span<const std::uint64_t> removed_rows, std::span<const Id> inserted_ids);
  void edit_rank(int rank, const SlotEdit& edit, std::span<const std::uint64_t> arriving);
  void list_by_id();
  Status apply_full(std::span<const Change> changes);
  Status apply_partial(std::vector<Change> changes);

  std::uint64_t count_ = 0;
  std::uint64_t version_ = 0;
  std::uint64_t checksum_ = 0;
  std::uint64_t number_ = 0;
  std::vector<Id> ids_;                    // by row; empty: id = row
  std::vector<std::uint64_t> rows_by_id_;  // ascending id; empty: rows are in that order; unused with index_
  std::optional<boost::unordered_flat_map<Id, std::uint64_t>> index_;  // row by id, from the first edit on
  std::vector<std::vector<std::uint64_t>> rows_;                       // by rank, in slot order
  std::vector<std::int32_t> rank_of_row_;
  std::vector<std::uint64_t> slot_of_row_;
};

}  // namespace rcb::layout
