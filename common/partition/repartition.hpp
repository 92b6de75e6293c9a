// Repartition: new cuts for particles that have cuts already. The answer is the one that partition() gives, bit for
// bit, but the work is in proportion to what changes: the current loads tell exactly how far each cut is off, so only
// particles near the expected new cuts are searched (buckets/put_held.hpp), and only their parts may change.
//
// Invariants
// 1. The tree and the parts don't depend on what was guessed; `cost`, `incremental` and `wasted` do.
#pragma once

#include <functional>

#include "common/partition/buckets/put_held.hpp"

namespace rcb::partition {

struct Repartition {
  CutTree tree;
  PartDelta delta;
  LoadSummary loads;
  SearchCost cost;
  bool incremental = false;  // only particles near the cuts were searched, as expected
  bool wasted = false;       // an incremental search was tried in vain: all particles were searched, or almost
};

struct RepartitionOptions {
  PartitionOptions partition;
  bool incremental = true;  // false: a search among all particles, for comparison
  // Called before more particles are searched than expected, which needs up to 20 bytes of each; may be empty.
  std::function<void()> before_search_of_all;
};

// Collective. Positions are finite, the parts are those of the tree; all ranks pass the same options. options.partition
// has the tree's method, parts and part sizes. With a cut tolerance every search is one among all particles, since cuts
// within a tolerance depend on where a search begins.
Repartition repartition(comm::Comm& comm, const particles::ParticleView& particles, const RepartitionOptions& options,
                        const CurrentPartition& current);

}  // namespace rcb::partition
