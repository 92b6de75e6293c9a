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

// When a partition begins with the tree of a sample (guess.hpp).
struct GuessLimits {
  std::uint64_t count_min = std::uint64_t{3} << 18U;  // particles a rank
  int parts_min = 4;
  int parts_max = 8;
  std::uint64_t stride = 128;  // one particle of so many is sampled, within these numbers
  std::uint64_t sample_min = 4096;
  std::uint64_t sample_max = 65536;
  // A node's particles are taken to reach beyond its sampled ones by this fraction of their extent at most, to either
  // side.
  double reach = 0.05;
  // Where a greater share of a node's sampled particles has the cut's coordinate, all with it would be searched.
  double tied = 0.01;
};

// How cuts are searched; no answer depends on it.
struct SearchLimits {
  std::uint64_t chunk_max = std::uint64_t{1} << 31U;  // particles handled by 32-bit numbers together
  std::uint64_t gather_max = 512;                     // candidates of a node that are gathered at once, >= 1
  std::uint64_t bins_max = 2048;                      // of a histogram, a power of two >= 2
  // Of a repartition: a bracket reaches this many standard deviations of a sampled count, and this many sampled
  // particles more, to either side; with more than 1 / few_share of all particles in brackets, or in nodes where they
  // don't suffice, all are searched.
  double bracket_sigmas = 3;
  double bracket_margin = 2;
  std::uint64_t few_share = 5;
  GuessLimits guess;
};

struct PartitionOptions {
  Method method = Method::rcb;
  int parts = 1;
  std::vector<double> part_sizes;     // empty: equal; else `parts` finite numbers > 0
  double axis_hysteresis = 1.0;       // finite, >= 1; 1: the pure rule
  const CutTree* previous = nullptr;  // the tree in force, for hysteresis; null: none
  // 0: exact. Else a search stops as soon as no part's load can be off its target by more than this fraction.
  double cut_tolerance = 0;
  SearchLimits limits;
};

struct PartitionResult {
  CutTree tree;
  Buffer<std::int32_t> part;          // [local count], the part of each local particle
  std::vector<std::uint64_t> counts;  // of each part, all ranks; empty where weights count
  std::uint64_t searched = 0;         // particles that a search looked at, all ranks
  std::uint64_t rounds = 0;           // search rounds (a round: one histogram reduction for a group of nodes)
  std::uint64_t reductions = 0;       // all collectives used
};

// The box of all ranks' particles; empty without any. Collective (one reduction).
geometry::Box bounding_box(Comm& comm, const particles::ParticleView& particles);

// Collective. All ranks pass the same options; positions finite and ids unique (the caller has checked).
//   particles  this rank's; any split over the ranks gives the same tree, bit for bit
//   go_on      asked between the levels of the tree
// Errors: invalid_argument (the same on every rank): parts < 1, bad sizes, dims against method; aborted, by go_on.
Result<PartitionResult> partition(Comm& comm, const particles::ParticleView& particles, const PartitionOptions& options,
                                  const GoOn& go_on = {});

// The part of each particle for the methods without a search: equal_boxes also returns its tree
// (cuts at the middle of each box; a coordinate equal to the middle goes right), file_order only `part`
// (blocks in ascending id by the quotas, weights or not; its tree is a default one). Collective.
Result<PartitionResult> baseline(Comm& comm, const particles::ParticleView& particles, const PartitionOptions& options,
                                 const GoOn& go_on = {});

}  // namespace rcb::partition
