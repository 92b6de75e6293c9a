// Room `scene`: what a rank keeps of a scene between orders: particles, tree, options, policy, reports. No collectives.
//
// Scene: a named particle set with its options, partition and history; each rank has its share of the particles.
//
// Invariants
// 1. Everything but `particles`, `part` and the report history is the same on all ranks.
// 2. After every order this rank holds exactly the particles of its parts, in the layout's order, and part[i] is the
//    part of particle i under `tree`.
// 3. Only rank 0 keeps reports; every rank keeps the last kRememberedSteps steps and their sessions.
#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <boost/unordered/unordered_flat_map.hpp>

#include "common/base/buffer.hpp"
#include "common/cuts/cuts.hpp"
#include "common/cuts/regions.hpp"
#include "common/particles/particle_set.hpp"
#include "common/partition/balance/load.hpp"
#include "server/service/scene/history.hpp"
#include "server/service/scene/policy.hpp"

namespace rcb::service {

// What an automatic repartition searches anew: all cuts, or those of the smallest subtrees that bring the error below
// half the tolerance.
enum class Recut { all, subtree };

struct SceneOptions {
  int parts = 1;
  int dims = 3;
  cuts::Method method = cuts::Method::rcb;
  double tolerance = 0.1;  // may be infinity
  double axis_hysteresis = 1.2;
  double cut_tolerance = 0;  // for every search; 0: exact cuts
  Recut recut = Recut::all;
  Policy policy = Policy::tolerance;
  std::vector<double> part_sizes;
};

struct SceneTotals : StepCounts {
  std::uint64_t steps = 0;
  std::uint64_t repartitions = 0;  // including the first partition
  std::map<std::string, std::uint64_t> skipped;
  std::map<std::string, std::uint64_t> asked;  // by command: queries whose answer took a pass over the particles
};

// The slot of each id that this rank holds. Built when it is first needed, then updated with the particles.
struct IdIndex {
  boost::unordered_flat_map<particles::Id, std::uint64_t> slot;
  std::optional<std::uint64_t> plan_version;  // the version of the layout that it describes
};

// A committed step, and the session_key() of the session that pushed it.
struct RememberedStep {
  std::int64_t step = 0;
  std::uint64_t session = 0;
};
// XXH3-64 of the session's name, which takes less memory than the text.
std::uint64_t session_key(const std::string& session);

struct Scene {
  static constexpr std::size_t kRememberedSteps = 1024;

  std::string name;
  SceneOptions options;

  bool recreated = false;  // made anew by its client after the service had lost it
  bool pushed = false;     // a first push was committed
  bool ids = false;        // ids aren't 0..n-1
  std::uint64_t n = 0;
  particles::ParticleSet particles;
  Buffer<std::int32_t> part;

  cuts::CutTree tree;
  std::optional<std::uint64_t> tree_hash;  // set by cuts_hash(), until the tree changes
  std::uint64_t epoch = 0;
  cuts::Regions regions;  // for the cuts of epoch regions_epoch
  std::uint64_t regions_epoch = 0;
  partition::LoadSummary loads;                  // current loads of the parts
  std::optional<double> error_when_not_adopted;  // error_before of the last wasted search
  CostAccount costs;                             // used if the policy is cost
  // Back-off after a wasted incremental search: the next full_searches_left repartitions search all particles.
  // full_searches_last is the number that the last wasted one caused (1, 3, then 7; 0 after a success).
  int full_searches_left = 0;
  int full_searches_last = 0;
  std::uint64_t search_rounds = 0;  // of the search for the current partition
  std::uint64_t search_reductions = 0;

  std::uint64_t plan_version = 0;
  std::uint64_t plan_checksum = 0;

  std::array<Buffer<double>, 3> spare;  // memory for the next push from shared memory

  IdIndex index;
  std::optional<std::uint64_t> id_next;  // above every id ever used; set at the first insertion or removal

  std::optional<std::int64_t> step;
  std::deque<RememberedStep> recent_steps;  // ascending
  bool asked = false;                       // a query as in SceneTotals::asked came since the last step
  std::unique_ptr<History> history;         // on rank 0
  SceneTotals totals;
  std::optional<cuts::Cuts> known_cuts;  // those of snapshot()

  // The tree's hash; computed once for each tree.
  std::uint64_t cuts_hash();
  // What the tree tells; made when it is first asked for in an epoch, since it takes some hundred bytes a part.
  const cuts::Cuts& snapshot();

  // A scene without particles, before its first push.
  static Scene create(std::string name, SceneOptions options);
};

}  // namespace rcb::service
