// Seeded particle sets, from plain to nasty, and how they are dealt to ranks.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "common/base/random.hpp"
#include "common/particles/particle_set.hpp"

namespace rcb::testing {

// A whole particle set, as one rank would hold it.
struct Scene {
  std::string name;
  int dims = 3;
  std::array<std::vector<double>, 3> x;
  std::vector<std::int64_t> id;
  std::vector<double> weight;  // empty: none

  std::size_t count() const { return id.size(); }
};

enum class Shape {
  uniform,
  lattice,     // small integers: ties in every pattern
  coincident,  // all at one point
  half_coincident,
  planes,   // one axis of three values, the others uniform
  decades,  // twelve decades of scale
  offset,   // 1e12 away, spread 1e-3
  denormal,
  huge,         // up to 1.7e308, both signs
  signed_zero,  // 0.0 and -0.0 at random, with a few others
  clusters,
  line,  // two axes constant
};
inline constexpr int kShapes = 12;

enum class Weights { none, uniform, zeros, giant, equal, all_zero, small_integers, wide };
inline constexpr int kWeights = 8;

// Ids are 0..n-1 in a shuffled order, or scattered up to 2^63-1.
Scene make_scene(Shape shape, Weights weights, int dims, std::size_t count, bool scattered_ids, std::uint64_t seed);

// Some rank's share.
struct Share {
  particles::ParticleSet particles;
  std::vector<std::size_t> row;  // of the scene, for each particle
};
// These rows of the scene, in this order.
Share take(const Scene& scene, std::vector<std::size_t> rows);
// At random, in blocks, or all on one rank; in a shuffled order.
Share deal(const Scene& scene, int rank, int ranks, std::uint64_t seed);

}  // namespace rcb::testing
