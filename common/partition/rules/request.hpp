// Room `rules`: what is asked of a partition, what determines its cuts before any search, and what a search may be
// tuned by.
//
// What is asked of a search for cuts, and what it finds.
#pragma once

#include <cstdint>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/cuts/cut_tree.hpp"
#include "common/partition/rules/tuning.hpp"

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

struct PartitionOptions {
  Method method = Method::rcb;
  int parts = 1;
  std::vector<double> part_sizes;     // empty: equal; else `parts` finite numbers > 0
  double axis_hysteresis = 1.0;       // finite, >= 1; 1: always the longest axis
  const CutTree* previous = nullptr;  // the current tree, for hysteresis; null: none
  // 0: exact. Else a cut is accepted as soon as no part's load can be off its target by more than this fraction, and by
  // one particle (with weights, half the greatest weight) a level.
  double cut_tolerance = 0;
  Tuning tuning;
};

// What a search costs. It is told, and decides nothing.
struct SearchCost {
  std::uint64_t searched = 0;    // particles that were searched, all ranks
  std::uint64_t rounds = 0;      // search rounds (a round: histograms of all nodes that still need one)
  std::uint64_t reductions = 0;  // collectives used
  // Of this rank's passes over memory; the few particles that are sampled or gathered aren't counted.
  std::uint64_t reads = 0;  // positions of particles
  std::uint64_t bytes = 0;  // of positions, quantised points and parts, read and written

  void operator+=(const SearchCost& other) {
    searched += other.searched;
    rounds += other.rounds;
    reductions += other.reductions;
    reads += other.reads;
    bytes += other.bytes;
  }
};

struct PartitionResult {
  CutTree tree;
  Buffer<std::int32_t> part;          // [local count], the part of each local particle
  std::vector<std::uint64_t> counts;  // of each part, all ranks; empty where weights count, or with one part
  SearchCost cost;                    // `searched`, `rounds` and `reductions` are the same on all ranks
};

}  // namespace rcb::partition
