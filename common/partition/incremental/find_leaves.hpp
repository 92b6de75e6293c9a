// The leaf of each particle of a block under a guess: the loops that take most of a partition's time, with the best
// instructions that the processor has: from rounded coordinates (find_leaves.cpp), and for the few that these don't
// decide from whole keys (find_leaves_by_key.cpp).
#pragma once

#include <array>
#include <cstdint>

#include "common/particles/block_ranges.hpp"
#include "common/partition/incremental/boundary_list.hpp"
#include "common/partition/incremental/guess_tables.hpp"

namespace rcb::partition {

using LeafCounts = std::array<std::uint64_t, GuessTables::kLeaves>;

// The particles of a block, one bit each.
struct FoundLeaves {
  std::uint64_t boundary = 0;           // in a bracket, or so near to one that their floats can't tell
  std::uint64_t unsure = 0;             // not decided by rounded coordinates
  std::array<std::uint64_t, 3> bits{};  // of the number of each particle's leaf

  std::size_t leaf(std::size_t k) const {
    return (bits[0] >> k & 1U) | (bits[1] >> k & 1U) << 1U | (bits[2] >> k & 1U) << 2U;
  }
};

// From rounded coordinates. x: of a block's particles, a valid pointer for every axis; part: of each particle so far,
// if there are several roots (any part of its root will do); becomes that of its leaf.
FoundLeaves find_leaves(const GuessTables& tables, const Axes& x, std::int32_t* part, std::size_t count);

// Decides the unsure ones by their whole keys: each joins the boundary particles or gets its leaf. part: as
// find_leaves() left it. Returns those that are interior but lie outside of their leaf's box.
std::uint64_t find_leaves_by_key(const GuessTables& tables, const Axes& x, const particles::Id* id, std::int32_t* part,
                                 FoundLeaves& found);

// Adds to sums[k], for each k, how many of a block's particles lie in leaves whose number has all bits of k set: bits
// of masks are counted faster than leaves. counts_of() subtracts what was counted more than once.
void add_leaves(const FoundLeaves& found, std::size_t count, LeafCounts& sums);

// How many particles each leaf has. sums: from add_leaves().
LeafCounts counts_of(LeafCounts sums);

}  // namespace rcb::partition
