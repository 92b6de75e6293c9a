// Plan: who holds what in which order. Client and service derive the same next plan from the changes of a step
// alone; the rule and the checksum are stated in common/wire/PROTOCOL.md.
//
// Invariants
// 1. Rank r holds its particles in slots 0..count-1; a full plan lists them in ascending id.
// 2. The plan before the first partition is blocks by row: rank r has rows [floor(r n/R), floor((r+1) n/R)).
// 3. version rises with every commit that moved a particle between ranks; checksum is the sum (mod 2^64) of
//    place_mix(id, rank, slot) over all particles, so it can be updated from the movers alone.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/particles/particle_set.hpp"

namespace rcb::plan {

using particles::Id;

// The parts that rank r of `ranks` owns: [part_begin(r), part_begin(r + 1)).
std::int64_t part_begin(int rank, int parts, int ranks);
int rank_of_part(int part, int parts, int ranks);
// The rows of the block plan: [row_begin(r), row_begin(r + 1)).
std::uint64_t row_begin(int rank, std::uint64_t count, int ranks);

std::uint64_t place_mix(Id id, int rank, std::uint64_t slot);

// A change so large that every rank goes back to ascending id instead of filling holes.
bool is_full_change(std::uint64_t rank_changes, std::uint64_t count);

// What one rank does with its arrays when particles leave and arrive (not used for a full change).
struct SlotMove {
  std::uint64_t to;
  std::uint64_t from;  // a slot (>= new count, or freed nowhere), or arrival index if `arrival`
  bool arrival;
};
struct RankEdit {
  std::uint64_t new_count = 0;
  std::vector<SlotMove> moves;  // no source slot is also a destination
};
// leaving: ascending slots; arrivals are numbered 0.. in ascending id.
RankEdit edit_of_rank(std::uint64_t count, std::span<const std::uint64_t> leaving, std::uint64_t arrivals);

// The whole plan, as the client holds it.
class Plan {
 public:
  // The block plan of n rows with these ids (empty: id = row).
  static Plan blocks(std::uint64_t count, int ranks, std::span<const Id> ids);
  // As received from the service: ids in slot order, rank after rank.
  static Plan full(std::vector<std::uint64_t> rank_counts, std::vector<Id> slot_ids, std::span<const Id> ids,
                   std::uint64_t version);

  int ranks() const { return static_cast<int>(rows_.size()); }
  std::uint64_t count() const { return count_; }
  std::uint64_t version() const { return version_; }
  std::uint64_t checksum() const { return checksum_; }
  // The rows (of the solver's arrays) that rank r holds, in slot order.
  std::span<const std::uint64_t> rows(int rank) const { return rows_[static_cast<std::size_t>(rank)]; }

  // The next plan, given each row whose rank changed and its new rank (any order). first: the scene's first
  // partition (always a full change).
  void apply(std::span<const std::uint64_t> changed_rows, std::span<const std::int32_t> new_ranks, bool first);

 private:
  std::uint64_t count_ = 0;
  std::uint64_t version_ = 0;
  std::uint64_t checksum_ = 0;
  std::vector<Id> ids_;                            // by row; empty: id = row
  std::vector<std::vector<std::uint64_t>> rows_;   // by rank, in slot order
  std::vector<std::int32_t> rank_of_row_;
  std::vector<std::uint64_t> slot_of_row_;
};

}  // namespace rcb::plan
