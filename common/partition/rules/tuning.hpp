// What the search is tuned by. Exact cuts don't depend on it; within a cut tolerance they do, so it must be the same
// everywhere. Tests make the limits so small that every branch is taken.
#pragma once

#include <cstdint>

namespace rcb::partition {

// When a partition begins with a sample, and how large that is.
struct SampleTuning {
  // Particles per rank: with fewer, the further collectives and the sample cost more than the passes that are saved.
  std::uint64_t count_min = std::uint64_t{3} << 16U;
  int parts_min = 4;
  // Particles per part and rank: with fewer, the segments into which cuts divide the buckets would take more memory
  // than the quantised points.
  std::uint64_t per_part_min = 256;
  std::uint64_t stride = 128;  // one particle of so many is sampled, if sample_min and sample_max allow
  std::uint64_t sample_min = 8192;
  std::uint64_t sample_max = 32768;
};

// How many particles a repartition samples: so many a part, within these limits.
struct RepartitionSampleTuning {
  std::uint64_t per_part = 128;
  std::uint64_t min = 4096;
  std::uint64_t max = 8192;
};

struct Tuning {
  // Fewer bins than this bound the number of rounds too weakly; with weights, a cell of a histogram has four words.
  static constexpr std::size_t kBinsMin = 64;
  static constexpr std::size_t kWeightedBinsMax = 256;
  static constexpr std::uint64_t kGatherAlways = 8;        // so few candidates aren't worth a histogram
  static constexpr std::uint64_t kGatheredTogether = 512;  // candidates of all nodes of a level
  // So many times as many are gathered where integers separate nothing any more, since key words cost more passes;
  static constexpr std::uint64_t kExhaustedFactor = 8;
  static constexpr std::uint64_t kNetworkFactor = 4;  // and likewise where a collective costs a network's latency.

  // Where so many particles of a block of 64 are chosen, points are made of the block as it is: from here on that takes
  // less time than to copy them out of it first.
  static constexpr int kMadeAsBlock = 24;

  std::uint64_t chunk_max = std::uint64_t{1} << 31U;  // particles per chunk, indexed with 32 bits
  std::uint64_t gather_max = 64;                      // candidates of a node that are gathered at once, >= 1
  std::uint64_t bins_max = 2048;                      // of a histogram; a power of two >= 2
  // A bracket extends this many standard deviations of a sampled count, plus this many sampled particles, to either
  // side.
  double bracket_sigmas = 3;
  double bracket_margin = 2;
  // Where an incremental search would list more than 1 / boundary_divisor of all particles, a full one is made.
  std::uint64_t boundary_divisor = 5;
  SampleTuning sample;
  RepartitionSampleTuning repartition_sample;
};

}  // namespace rcb::partition
