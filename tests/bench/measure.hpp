// Measuring one cell: all contenders in turn, repeat after repeat, each from barrier to barrier.
//
// Invariants
// 1. Every contender runs once before anything is timed. In each repeat another one begins, so that none always
//    follows the same neighbour.
// 2. What is told of an answer is counted from the parts that the contender itself gave, in every repeat; the worst
//    repeat is told.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/comm/comm.hpp"
#include "tests/bench/peers/contender.hpp"

namespace rcb::bench {

struct Measurement {
  Setting setting;
  std::vector<double> seconds;  // by repeat; the slowest rank's
  double error = 0;
  double imbalance = 1;
  std::uint64_t empty_parts = 0;
  std::optional<std::uint64_t> hash;
  std::optional<partition::SearchCost> cost;  // of all ranks together
  std::optional<double> bytes_per_particle;   // growth of the resident memory at its peak, all ranks together, over n
  std::string failure;                        // not empty: nothing above counts
};

struct MeasureOptions {
  int repeats = 1;
  bool memory = false;
  std::function<void(const Setting&)> on_turn;  // before each run, on every rank; may be empty
};

// Keeps memory that is freed, for all contenders alike: giving it back and fetching it again took a third of Zoltan's
// time. Local, before anything is allocated in earnest.
void keep_freed_memory();

// Reads every coordinate once, and returns something of them: the floor of whatever looks at all particles. Local.
std::uint64_t read_positions(const particles::ParticleView& particles);
std::uint64_t read_doubles(std::span<const double> values);

// Collective. The same on every rank. Contenders that don't fit the problem (Code::unsupported) are left out.
std::vector<Measurement> measure(comm::Comm& comm, const Problem& problem, const Contenders& contenders,
                                 const MeasureOptions& options);

// The middle value, of an even number the mean of the middle two; values not empty.
double median(std::vector<double> values);

}  // namespace rcb::bench
