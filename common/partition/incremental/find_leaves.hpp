// The leaf of each particle of a block under a guess: the loops that take most of a partition's time, with the best
// instructions that the processor has.
#pragma once

#include <array>
#include <cstdint>

#include "common/particles/block_ranges.hpp"
#include "common/partition/incremental/boundary_list.hpp"
#include "common/partition/incremental/guess_tables.hpp"

namespace rcb::partition {

using BlockLeaves = std::array<std::int32_t, particles::kBlock>;

// The particles of a block, one bit each.
struct FoundLeaves {
  std::uint64_t boundary = 0;           // surely not in their leaf's inner region
  std::uint64_t unsure = 0;             // not decided by rounded coordinates
  std::array<std::uint64_t, 3> bits{};  // of the number of each particle's leaf

  std::size_t leaf(std::size_t k) const {
    return (bits[0] >> k & 1U) | (bits[1] >> k & 1U) << 1U | (bits[2] >> k & 1U) << 2U;
  }
};

// From rounded coordinates. x: of a block's particles, a valid pointer for every axis; part: of each particle so far,
// if there are several roots (any part of its root will do); becomes that of its leaf. Adds to the counts of the
// leaves.
FoundLeaves find_leaves(const GuessTables& tables, const Axes& x, std::int32_t* part, std::size_t count,
                        std::array<std::uint64_t, GuessTables::kLeaves>& counts);

// From the whole keys of those particles of a block whose bits are set in `which`, one after the other: the leaf, or -1
// for a boundary particle.
void find_leaves_by_key(const GuessTables& tables, const Axes& x, const particles::Id* id, const std::int32_t* part,
                        std::uint64_t which, BlockLeaves& leaf);

}  // namespace rcb::partition
