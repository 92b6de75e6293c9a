// Commit: staged positions become the scene's; drift is judged, cuts are searched where the policy says so, and every
// particle goes to the rank that owns it.
#pragma once

#include "common/partition/partition.hpp"
#include "server/service/staging.hpp"

namespace rcb::service {

// Particles whose part changed in this step, on rank 0, ascending id.
struct PartChanges {
  Buffer<particles::Id> id;
  Buffer<std::int32_t> part;
};

// Collective. Can't fail: what could was checked by prepare(). `changes`: null where nobody asks. A later step leaves
// the positions before it in `staged`, whose memory may be used again.
StepReport commit(Context& context, Scene& scene, Staged& staged, const PushRequest& push, PartChanges* changes);

struct NewCuts {
  partition::CutTree tree;
  std::uint64_t rounds = 0;
  std::uint64_t reductions = 0;
};

// Puts new cuts in force: tree, loads, epoch, statistics of the search. The caller has set scene.part, and migrates.
// Local.
void adopt(Scene& scene, NewCuts found, partition::LoadSummary loads);

// Local particles that differ in two assignments.
std::uint64_t count_differences(std::span<const std::int32_t> a, std::span<const std::int32_t> b);

}  // namespace rcb::service
