// Plan: who holds what in which order. Client and service derive the same next plan from the changes of a step
// alone; the rule and the checksum are stated in common/wire/PROTOCOL.md, section "The plan".
//
// Invariants
// 1. Rank r holds its particles in slots 0..count-1; a full plan lists them in ascending id.
// 2. The plan before the first partition is blocks by row: rank r has rows [floor(r n/R), floor((r+1) n/R)).
// 3. version rises with every commit that moved a particle between ranks, inserted or removed one; checksum is the sum
// (mod 2^64) of
//    place_mix(id, rank, slot) over all particles, so it can be updated from the movers alone.
#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include <boost/unordered/unordered_flat_map.hpp>

#include "common/base/buffer.hpp"
#include "common/base/status.hpp"
#include "common/particles/particle_set.hpp"

namespace rcb::plan {

using particles::Id;

// The parts that rank r of `ranks` owns: [part_begin(r), part_begin(r + 1)).
std::int64_t part_begin(int rank, int parts, int ranks);
int rank_of_part(int part, int parts, int ranks);
// The rows of the block plan: [row_begin(r), row_begin(r + 1)).
std::uint64_t row_begin(int rank, std::uint64_t count, int ranks);

std::uint64_t place_mix(Id id, int rank, std::uint64_t slot);
// One rank's share of the checksum: its ids in slot order.
std::uint64_t checksum_of_rank(int rank, std::span<const Id> slot_ids);

// A change so large that every rank goes back to ascending id instead of filling holes.
bool is_full_change(std::uint64_t rank_changes, std::uint64_t count);

// What one rank does with its arrays when particles leave and arrive (not used for a full change).
struct SlotMove {
  std::uint64_t to;
  std::uint64_t from;  // arrival index if `arrival`, else a slot >= new_count
  bool arrival;
};
struct RankEdit {
  std::uint64_t new_count = 0;
  std::vector<SlotMove> moves;  // no source slot is also a destination, so their order does not matter
};
// leaving: ascending slots < count; arrivals are numbered 0.. in ascending id. Cost: O(leaving + arrivals).
RankEdit edit_of_rank(std::uint64_t count, std::span<const std::uint64_t> leaving, std::uint64_t arrivals);

// Carries an edit out on one array of the rank (an axis, the ids, the weights).
template <typename T>
void apply_edit(const RankEdit& edit, Buffer<T>& slots, std::span<const T> arrived) {
  slots.resize(std::max<std::size_t>(slots.size(), edit.new_count));
  for (const SlotMove& move : edit.moves) slots[move.to] = move.arrival ? arrived[move.from] : slots[move.from];
  slots.resize(edit.new_count);
}

// What the edit adds (mod 2^64) to the checksum. slot_ids: before the edit; arrived: ascending ids.
std::uint64_t checksum_change(const RankEdit& edit, int rank, std::span<const Id> slot_ids,
                              std::span<const std::uint64_t> leaving, std::span<const Id> arrived);

// The whole plan, as the client holds it.
class Plan {
 public:
  // The block plan of n rows with these ids (empty: id = row). The ids are the solver's: distinct and >= 0, which the
  // service checks at the first push.
  static Plan blocks(std::uint64_t count, int ranks, std::span<const Id> ids);
  // As received from the service: ids in slot order, rank after rank.
  // Errors: protocol_error where they aren't exactly the solver's ids.
  static Result<Plan> full(const std::vector<std::uint64_t>& rank_counts, std::span<const Id> slot_ids,
                           std::span<const Id> ids, std::uint64_t version);

  int ranks() const { return static_cast<int>(rows_.size()); }
  std::uint64_t count() const { return count_; }
  std::uint64_t version() const { return version_; }
  std::uint64_t checksum() const { return checksum_; }
  // The rows (of the solver's arrays) that rank r holds, in slot order.
  std::span<const std::uint64_t> rows(int rank) const { return rows_[static_cast<std::size_t>(rank)]; }
  int rank_of_row(std::uint64_t row) const { return rank_of_row_[row]; }
  Id id_of_row(std::uint64_t row) const { return ids_.empty() ? static_cast<Id>(row) : ids_[row]; }
  std::uint64_t slot_of_row(std::uint64_t row) const { return slot_of_row_[row]; }
  // The ids by row; empty: id = row.
  std::span<const Id> ids() const { return ids_; }
  // The row of that id; O(log n), O(1) where ids are rows.
  std::optional<std::uint64_t> row_of_id(Id id) const;

  // The next plan, given rows and their ranks after the commit (any order; rows whose rank stays are passed over).
  // first: the scene's first partition (always a full change).
  // Errors: protocol_error for a row or rank out of range or a row named twice; the plan is then as before.
  // Cost: O(m log m) for m changes; O(n) for a full change.
  Status apply(std::span<const std::uint64_t> changed_rows, std::span<const std::int32_t> new_ranks, bool first);

  // The plan after a commit's removals and insertions, before its changes of rank. removed_rows: ascending, distinct;
  // the inserted, with the ranks that own them, in the order given. Returns what becomes of the rows: they change as a
  // rank's slots do, the inserted taking the removed rows in the order given, the others being appended.
  // Errors: protocol_error for rows or ranks out of range and ids that are there already; the plan is then as before.
  // Cost: O(m log m) for m of them; once, O(n) for an index of the ids.
  Result<RankEdit> edit(std::span<const std::uint64_t> removed_rows, std::span<const Id> inserted_ids,
                        std::span<const std::int32_t> inserted_ranks);

 private:
  struct Change {
    std::uint64_t row;
    std::int32_t to;
  };

  Plan(std::uint64_t count, int ranks, std::span<const Id> ids);
  void put(std::uint64_t row, int rank, std::uint64_t slot);
  void sort_rows();
  Status check_edit(std::span<const std::uint64_t> removed_rows, std::span<const Id> inserted_ids,
                    std::span<const std::int32_t> inserted_ranks) const;
  void edit_ids(const RankEdit& rows, std::span<const std::uint64_t> removed_rows, std::span<const Id> inserted_ids);
  void edit_rank(int rank, const RankEdit& edit, std::span<const std::uint64_t> arriving);
  void list_by_id();
  Status apply_full(std::span<const Change> changes);
  Status apply_few(std::vector<Change> changes);

  std::uint64_t count_ = 0;
  std::uint64_t version_ = 0;
  std::uint64_t checksum_ = 0;
  std::vector<Id> ids_;                    // by row; empty: id = row
  std::vector<std::uint64_t> rows_by_id_;  // ascending id; empty: rows are in that order; unless index_
  std::optional<boost::unordered_flat_map<Id, std::uint64_t>> index_;  // row by id, from the first edit on
  std::vector<std::vector<std::uint64_t>> rows_;                       // by rank, in slot order
  std::vector<std::int32_t> rank_of_row_;
  std::vector<std::uint64_t> slot_of_row_;
};

}  // namespace rcb::plan
