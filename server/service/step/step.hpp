// Room `step`: turns checked particles into the scene's next state: drift, policy, new cuts, migration, results for
// members. Entry point: commit(), which can't fail.
//
// Commit: staged positions become the scene's, drift is applied, new cuts are searched if the policy says so, and every
// particle goes to the rank that owns it.
#pragma once

#include "common/partition/partition.hpp"
#include "server/service/push/staging.hpp"

namespace rcb::service {

// Particles whose part changed in this step, with their new parts, in ascending id; on rank 0.
struct PartChanges {
  Buffer<particles::Id> id;
  Buffer<std::int32_t> part;
};

// Collective. Can't fail: prepare() has checked everything. `changes`: nullptr if nobody asks for them. After any step
// but the first, `staged` holds the positions before the step, whose memory may be used again. Returns what rank 0's
// ledger is told; on other ranks the report alone.
scene::Stepped commit(Context& context, Scene& scene, Staged& staged, const PushRequest& push, PartChanges* changes);

// Takes in the particles that a service lacks which was started again: no step. Returns the answer. Collective; can't
// fail.
Response refill(Context& context, Scene& scene, Staged& staged, const PushRequest& push);

// What a search for all of a scene's cuts is asked. Local.
partition::PartitionOptions search_options(const SceneOptions& options);

struct NewCuts {
  cuts::CutTree tree;
  std::uint64_t rounds = 0;
  std::uint64_t reductions = 0;
};

// Puts new cuts in force: tree, loads, epoch, statistics of the search. The caller has set scene.part, and migrates
// afterwards. Local.
void adopt(Scene& scene, NewCuts found, partition::LoadSummary loads);

// What the ledger is told of what the ranks hold. Local, on rank 0.
scene::Held held_of(const Context& context, Scene& scene);

// Number of local particles whose parts differ in two assignments. Local.
std::uint64_t count_differences(std::span<const std::int32_t> a, std::span<const std::int32_t> b);

}  // namespace rcb::service
