// Scene: a named particle set with its options, partition and history, as one rank holds it.
//
// Invariants
// 1. Everything but `particles`, `part` and the report history is the same on all ranks.
// 2. After every order this rank holds exactly the particles of its parts, in the plan's order, and part[i] is the
//    part of particle i under `tree`.
// 3. Reports are kept on rank 0 alone; every rank remembers the last kRememberedSteps steps and their sessions.
#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <boost/unordered/unordered_flat_map.hpp>

#include "common/base/buffer.hpp"
#include "common/particles/particle_set.hpp"
#include "common/partition/cut_tree.hpp"
#include "common/partition/load.hpp"
#include "server/service/history.hpp"
#include "server/service/policy.hpp"
#include "server/service/regions.hpp"

namespace rcb::service {

// What an automatic repartition cuts anew: everything, or the smallest subtrees that bring the error below half the
// tolerance.
enum class Recut { all, subtree };

struct SceneOptions {
  int parts = 1;
  int dims = 3;
  partition::Method method = partition::Method::rcb;
  double tolerance = 0.1;  // may be infinity
  double axis_hysteresis = 1.2;
  double cut_tolerance = 0;  // of every search for cuts; 0: exact
  Recut recut = Recut::all;
  Policy policy = Policy::tolerance;
  std::vector<double> part_sizes;
};

struct SceneTotals {
  std::uint64_t steps = 0;
  std::uint64_t repartitions = 0;  // the first partition counts
  std::uint64_t bytes = 0;
  std::uint64_t drifted = 0;
  std::uint64_t moved = 0;
  std::uint64_t migrated = 0;
  std::uint64_t scanned = 0;
  std::uint64_t searched = 0;
  std::uint64_t rounds = 0;
  std::uint64_t reductions = 0;
  std::map<std::string, std::uint64_t> skipped;
  std::map<std::string, std::uint64_t> asked;  // questions that were answered from the particles, by command
  StepSeconds seconds;
};

// Where this rank holds which id; made at a scene's first need, then kept up with the particles.
struct IdIndex {
  boost::unordered_flat_map<particles::Id, std::uint64_t> slot;
  std::optional<std::uint64_t> plan_version;  // that it tells of
};

// A committed step, and session_key() of who pushed it.
struct RememberedStep {
  std::int64_t step = 0;
  std::uint64_t session = 0;
};
// XXH3-64 of the name: a few bytes instead of the text.
std::uint64_t session_key(const std::string& session);

struct Scene {
  static constexpr std::size_t kRememberedSteps = 1024;

  std::string name;
  SceneOptions options;

  bool recreated = false;  // its client made it anew, since the service had lost it
  bool pushed = false;     // a first push was committed
  bool ids = false;        // ids aren't 0..n-1
  std::uint64_t n = 0;
  particles::ParticleSet particles;
  Buffer<std::int32_t> part;

  partition::CutTree tree;
  std::optional<std::uint64_t> tree_hash;  // once it was asked for
  std::uint64_t epoch = 0;
  Regions regions;  // under the cuts of regions_epoch
  std::uint64_t regions_epoch = 0;
  partition::LoadSummary loads;                  // after the last order that changed them
  std::optional<double> error_when_not_adopted;  // error_before of the last attempt that was not adopted
  CostAccount costs;                             // kept where the policy is cost
  // Repartitions that still search all particles, and how many the last failure to do with few is worth.
  int cold_left = 0;
  int cold_last = 0;
  std::uint64_t search_rounds = 0;  // of the partition in force
  std::uint64_t search_reductions = 0;

  std::uint64_t plan_version = 0;
  std::uint64_t plan_checksum = 0;

  IdIndex index;
  std::optional<std::uint64_t> id_next;  // above every id ever used; known from the first insertion or removal on

  std::optional<std::int64_t> step;
  std::deque<RememberedStep> recent_steps;  // ascending
  bool asked = false;                       // such a question since the last step
  std::unique_ptr<History> history;         // on rank 0
  SceneTotals totals;

  // The tree's hash, made once a tree.
  std::uint64_t cuts_hash();

  // Empties each axis, sets dims; before the first push.
  static Scene create(std::string name, SceneOptions options);
};

}  // namespace rcb::service
