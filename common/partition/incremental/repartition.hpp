// Room `incremental`: new cuts from the cuts in force. Brackets divide interior from boundary particles. It may guess;
// the search verifies.
//
// Repartition: new cuts for particles that have cuts already. The answer is the one that partition() gives, bit for
// bit, but the work is in proportion to what changes: the current loads tell exactly how far each cut is off, so only
// particles near the expected new cuts are searched (brackets.hpp, classify_interior.hpp), and only their parts may
// change. Where interior particles would not stay, a subtree is searched among all its particles.
//
// Invariants
// 1. The tree and the parts don't depend on what was guessed; `looked_at`, `incremental` and `wasted` do.
#pragma once

#include <cstdint>
#include <functional>

#include "common/base/buffer.hpp"
#include "common/partition/balance/load.hpp"
#include "common/partition/incremental/brackets.hpp"
#include "common/partition/search/request.hpp"

namespace rcb::partition {

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
  std::uint64_t looked_at = 0;  // particles that were searched, all ranks
  bool incremental = false;     // no node needed a search among all its particles
  bool wasted = false;          // an incremental search was tried in vain: all particles were searched
};

struct RepartitionOptions {
  PartitionOptions partition;
  bool incremental = true;  // false: a full search, for comparison
  // Called before nodes are searched among all their particles, which needs 20 bytes of each; may be empty.
  std::function<void()> before_search_of_all;
};

// Collective. Positions are finite, the parts are those of the tree; all ranks pass the same options. options.partition
// has the tree's method, parts and part sizes. With a cut tolerance every search is full, since cuts within a tolerance
// depend on where a search begins.
Repartition repartition(comm::Comm& comm, const particles::ParticleView& particles, const RepartitionOptions& options,
                        const CurrentPartition& current);

}  // namespace rcb::partition
