// Room `search`: the exact cuts of a tree, level by level, from histograms of quantised coordinates. Entry: TreeBuilder
// (build_tree.hpp). No optimisation may change the tree: tests/common/partition compares it with brute force.
//
// What is asked of a search for cuts, and what it finds.
#pragma once

#include <cstdint>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/cuts/cut_tree.hpp"

namespace rcb::partition {

using cuts::AxisOrder;
using cuts::Cut;
using cuts::CutTree;
using cuts::Id;
using cuts::Key;
using cuts::key_between;
using cuts::Method;
using cuts::NodeRange;
using cuts::Point;

// When a partition begins with the buckets of a sample (buckets.hpp), and how much the sample is trusted.
struct BucketLimits {
  // Particles per rank: with fewer, the further collectives and the sample cost more than the passes that are saved.
  std::uint64_t count_min = std::uint64_t{3} << 16U;
  int parts_min = 4;
  // Particles per part and rank: with fewer, the spans into which cuts divide the buckets would take more memory than
  // the quantised points.
  std::uint64_t per_part_min = 256;
  std::uint64_t stride = 128;  // one particle of so many is sampled, if sample_min and sample_max allow
  std::uint64_t sample_min = 8192;
  std::uint64_t sample_max = 32768;
  // The particles are assumed to reach beyond the sampled ones by at most so many times the distance from the outermost
  // sampled one to the ninth, on either side.
  double overhang = 3;
};

// Tuning of the search. Exact cuts don't depend on it; within a cut tolerance they do, so it must be the same
// everywhere.
struct SearchLimits {
  std::uint64_t chunk_max = std::uint64_t{1} << 31U;  // particles per chunk, indexed with 32 bits
  std::uint64_t gather_max = 64;                      // candidates of a node that are gathered at once, >= 1
  std::uint64_t bins_max = 2048;                      // of a histogram; a power of two >= 2
  // A bracket extends this many standard deviations of a sampled count, plus this many sampled particles, to either
  // side.
  double bracket_sigmas = 3;
  double bracket_margin = 2;
  // Incremental search: if brackets, or nodes that failed, hold more than 1 / boundary_divisor of all particles, a full
  // search is made.
  std::uint64_t boundary_divisor = 5;
  BucketLimits buckets;
};

struct PartitionOptions {
  Method method = Method::rcb;
  int parts = 1;
  std::vector<double> part_sizes;     // empty: equal; else `parts` finite numbers > 0
  double axis_hysteresis = 1.0;       // finite, >= 1; 1: always the longest axis
  const CutTree* previous = nullptr;  // the current tree, for hysteresis; null: none
  // 0: exact. Else a cut is accepted as soon as no part's load can be off its target by more than this fraction, and by
  // one particle (with weights, half the greatest weight) a level.
  double cut_tolerance = 0;
  SearchLimits limits;
};

// What passes over memory cost. The few particles that are sampled or gathered aren't counted.
struct Traffic {
  std::uint64_t reads = 0;  // positions of particles
  std::uint64_t bytes = 0;  // of positions, quantised points and parts, read and written

  void operator+=(const Traffic& other) {
    reads += other.reads;
    bytes += other.bytes;
  }
};

struct PartitionResult {
  CutTree tree;
  Buffer<std::int32_t> part;          // [local count], the part of each local particle
  std::vector<std::uint64_t> counts;  // of each part, all ranks; empty where weights count, or with one part
  std::uint64_t searched = 0;         // particles that were searched, all ranks
  std::uint64_t rounds = 0;           // search rounds (a round: histograms of all nodes that still need one)
  std::uint64_t reductions = 0;       // collectives used
  Traffic traffic;                    // of this rank
};

}  // namespace rcb::partition
