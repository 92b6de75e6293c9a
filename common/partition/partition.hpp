// Partition a distributed particle set into P parts: exact RCB, and bands as a tree with one axis order.
// Particles stay where they are; the result names each local particle's part.
//
// Source: Berger and Bokhari 1987, doi:10.1109/TC.1987.1676942 (recursive bisection).
#pragma once

#include <cstdint>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/partition/comm.hpp"
#include "common/partition/cut_tree.hpp"

namespace rcb::partition {

// How cuts are searched; no answer depends on it.
struct Refinement {
  std::uint64_t points_min = 50'000;  // with fewer particles each level is searched from its bounds, without a guess
  std::uint64_t sample = 0;           // points in the sample; 0: as many as balance its cost and its use
  double sigmas = 2.2;                // half a bracket's width, in standard deviations of the sample's guess
};

struct PartitionOptions {
  Method method = Method::rcb;
  int parts = 1;
  std::vector<double> part_sizes;     // empty: equal; else `parts` finite numbers > 0
  double axis_hysteresis = 1.0;       // finite, >= 1; 1: the pure rule
  const CutTree* previous = nullptr;  // the tree in force, for hysteresis; null: none
  Refinement refinement;
};

// What the refinement of a guess cost, all ranks together but for `scanned`; all 0 where none was made.
struct RefineCounts {
  std::uint64_t passes = 0;   // over all particles
  std::uint64_t scanned = 0;  // particles looked at in them, on this rank
  std::uint64_t sampled = 0;
  std::uint64_t stashed = 0;     // found in a bracket
  std::uint64_t missed = 0;      // brackets that did not hold their cut, and
  std::uint64_t wrong_axes = 0;  // nodes whose longest axis was guessed wrong: mended by another pass
};

struct PartitionResult {
  CutTree tree;
  Buffer<std::int32_t> part;     // [local count], the part of each local particle
  std::uint64_t rounds = 0;      // search rounds (a round: one histogram reduction for a group of nodes)
  std::uint64_t reductions = 0;  // all collectives used
  RefineCounts refined;
};

// The box of all ranks' particles; empty without any. Collective (one reduction).
geometry::Box bounding_box(Comm& comm, const particles::ParticleView& particles);

// Collective. All ranks pass the same options; positions finite and ids unique (the caller has checked).
//   particles  this rank's; any split over the ranks gives the same tree, bit for bit
// Errors: invalid_argument (the same on every rank): parts < 1, bad sizes, dims against method.
Result<PartitionResult> partition(Comm& comm, const particles::ParticleView& particles,
                                  const PartitionOptions& options);

// The part of each particle for the methods without a search: equal_boxes also returns its tree
// (cuts at the middle of each box; a coordinate equal to the middle goes right), file_order only `part`
// (blocks in ascending id by the quotas, weights or not; its tree is a default one). Collective.
Result<PartitionResult> baseline(Comm& comm, const particles::ParticleView& particles, const PartitionOptions& options);

}  // namespace rcb::partition
