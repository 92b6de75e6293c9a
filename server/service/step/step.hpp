// Room `step`: turns checked particles into the scene's next state: policy, new cuts, migration. Entry point: commit(),
// which can't fail.
//
// Commit: what was staged becomes the scene's, new cuts are searched if the policy says so, and every particle goes to
// the rank that owns it.
#pragma once

#include "common/partition/partition.hpp"
#include "server/service/push/staging.hpp"

namespace rcb::service {

// Collective. Can't fail: prepare() has checked everything. Afterwards `staged` holds what the scene held before, whose
// memory may be used again. Returns what rank 0's ledger is told; on other ranks the report alone.
scene::Stepped commit(Context& context, Scene& scene, Staged& staged, const PushRequest& push);

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

}  // namespace rcb::service
