// Repartition: new cuts for particles that have cuts already. The answer is the one that partition() gives, bit for
// bit, but the work is in proportion to what changes: the cuts in force tell exactly how far each is off, so only
// particles near where the new ones must lie are looked at (brackets.hpp, settle.hpp), and only their parts may change.
// Where that turns out not to hold, a subtree is searched among all its particles.
//
// Invariants
// 1. The tree and the parts don't depend on what was guessed; `looked_at` and `cold` do.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/particles/block_ranges.hpp"
#include "common/partition/brackets.hpp"
#include "common/partition/load.hpp"
#include "common/partition/partition.hpp"

namespace rcb::partition {

// What is in force.
struct Standing {
  const CutTree& tree;
  std::span<const std::int32_t> part;  // of the local particles, under the tree
  const LoadSummary& loads;            // of those parts, all ranks
  OwnParts own;
  const particles::BlockRanges* blocks = nullptr;  // of the local particles; null: not known
};

// Local particles whose part changes.
struct PartDelta {
  Buffer<std::uint64_t> slot;  // ascending
  Buffer<std::int32_t> part;   // the new one
};

struct Repartition {
  CutTree tree;
  PartDelta delta;
  LoadSummary loads;
  std::uint64_t rounds = 0;
  std::uint64_t reductions = 0;
  std::uint64_t looked_at = 0;  // particles that a search looked at, all ranks
  bool warm = false;            // no search looked at all of them
  bool in_vain = false;         // few were looked at, and then all: warm would better not have been tried
};

struct RepartitionOptions {
  PartitionOptions partition;
  // Nodes of the tree in force that are cut anew, apart from each other, ascending; all other cuts stay, and a root's
  // particles are shared among its parts alone. Empty: everything.
  std::vector<NodeRange> roots;
  bool warm = true;  // false: all particles are searched, for comparison
  // Called before a search among all particles, which needs 16 bytes of each; may be empty.
  std::function<void()> before_search_of_all;
};

// Collective. The particles' positions are finite, the parts those of the tree; all ranks pass the same options.
// options.partition has the tree's method, parts and part sizes. With a cut tolerance nothing is warm, since its cuts
// depend on where a search begins.
Repartition repartition(Comm& comm, const particles::ParticleView& particles, const RepartitionOptions& options,
                        const Standing& standing);

}  // namespace rcb::partition
