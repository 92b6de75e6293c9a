// What a search costs. It is told, and decides nothing.
#pragma once

#include <cstdint>

namespace rcb::partition {

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

}  // namespace rcb::partition
