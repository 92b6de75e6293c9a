// The benchmark's particle sets. Every point follows from its index alone, so each rank makes its own rows, and the set
// is the same on any number of ranks.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "common/particles/particle_set.hpp"

namespace rcb::bench {

struct SceneKind {
  const char* name;
  const char* what;
  int dims;
  std::uint64_t points;  // unless told otherwise
};

std::span<const SceneKind> scene_kinds();
const SceneKind* find_scene_kind(const std::string& name);  // null: none of that name

// Rows [first, last) of the scene of n points; ids are the rows.
particles::ParticleSet make_rows(const SceneKind& kind, std::uint64_t n, std::uint64_t first, std::uint64_t last);

}  // namespace rcb::bench
