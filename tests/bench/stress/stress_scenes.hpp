// The scenes of rcb_stress: those of rcb_bench that are hard on a partitioner's arithmetic, and worse ones. As there,
// every point follows from its row.
#pragma once

#include <cstdint>
#include <span>
#include <string>

#include "common/particles/particle_set.hpp"

namespace rcb::bench {

struct StressScene {
  const char* name;
  const char* what;
  int dims;
};

std::span<const StressScene> stress_scenes();
const StressScene* find_stress_scene(const std::string& name);  // null: none of that name

// Rows [first, last) of the scene of n points; ids are the rows.
particles::ParticleSet make_stress_rows(const StressScene& scene, std::uint64_t n, std::uint64_t first,
                                        std::uint64_t last);

}  // namespace rcb::bench
