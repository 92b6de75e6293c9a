// Room `scene`: what a rank keeps of a scene between orders: particles, tree, options. No collectives. What follows
// from its steps (loads of counts, policy, reports) only rank 0 knows: server/scene.
//
// Scene: a named particle set with its options, partition and history; each rank has its share of the particles.
//
// Invariants
// 1. Everything but `particles` and `part` is the same on all ranks.
// 2. After every order this rank holds exactly the particles of its parts, in any order, and part[i] is the part of
//    particle i under `tree`.
// 3. `step` is that of the positions held, none before a first push to this service; later steps may have been counted
//    only. `loads` are those of these positions.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/cuts/cuts.hpp"
#include "common/cuts/regions.hpp"
#include "common/particles/particle_set.hpp"
#include "common/partition/balance/load.hpp"
#include "server/scene/events.hpp"

namespace rcb::service {

using scene::SceneOptions;
using scene::StepReport;

// Another sum of the ids, with a key that no client knows: whoever pushes other ids, or one twice, can't make it come
// out right. none: not drawn yet.
struct IdKey {
  std::optional<std::uint64_t> key;
  std::uint64_t sum = 0;  // of mix64(id + key), all ranks
};

struct Scene : scene::Held {
  std::string name;
  SceneOptions options;

  std::optional<std::int64_t> step;
  IdKey key;
  particles::ParticleSet particles;
  Buffer<std::int32_t> part;

  cuts::Regions regions;  // for the cuts of epoch regions_epoch
  std::uint64_t regions_epoch = 0;
  // Back-off after a wasted incremental search: the next full_searches_left repartitions search all particles.
  // full_searches_last is the number that the last wasted one caused (1, 3, then 7; 0 after a success).
  int full_searches_left = 0;
  int full_searches_last = 0;
  std::optional<cuts::Cuts> known_cuts;  // those of snapshot()

  // What the tree tells; made when it is first asked for in an epoch, since it takes some hundred bytes a part.
  const cuts::Cuts& snapshot();

  // A scene without particles, before its first push.
  static Scene create(std::string name, SceneOptions options);
};

}  // namespace rcb::service
