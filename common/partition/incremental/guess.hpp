// Guess: the cuts that are expected, from a sample of the particles, before any other particle is looked at.
//
// Invariants
// 1. A wrong guess costs time only: the search verifies what it relies on (interior.hpp).
#pragma once

#include <cstdint>
#include <vector>

#include "common/comm/comm.hpp"
#include "common/geometry/box.hpp"
#include "common/partition/search/interior.hpp"
#include "common/partition/search/request.hpp"
#include "common/partition/search/sorted_sample.hpp"

namespace rcb::partition {

// A guess has at most so many levels and leaves, which fit into the tables of one pass (guess_tables.hpp).
inline constexpr int kGuessLevels = 3;
inline constexpr int kGuessLeaves = 8;

struct Guess {
  CutTree tree;                      // of each cut, the axis and the expected coordinate
  std::vector<std::uint8_t> ends;    // [inner nodes]: 1: nothing is guessed from this node on
  std::vector<KeyBracket> brackets;  // [inner nodes]
  // [parts]: inner regions (brackets.hpp). The parts below a node of `ends` share one region, which stands at the first
  // of them.
  std::vector<geometry::Box> inner;
  std::vector<geometry::Box> seen;  // [parts]: bounding boxes of the sampled particles strictly inside of `inner`
  bool tied = false;                // several sampled particles lie on one face of such a box
  // Set, and nothing is guessed, if the sample leaves the root's longest axis open, or, where whole keys count, the
  // order of the others: the bounding boxes of its sampled particles on either side of the expected cut. The particles
  // outside of both would tell.
  std::vector<geometry::Box> open;
  bool found = false;  // enough cuts
};

// Nodes whose cuts are to be guessed.
struct GuessRoots {
  CutTree tree;                      // whose cuts above the roots are exact
  std::vector<NodeRange> roots;      // none below another
  std::vector<geometry::Box> boxes;  // [roots]: of their particles; empty: not known
  const Guess* before = nullptr;     // the guess that left them uncut; null: none was made
};

// Guesses the cuts below some nodes. The guess has at most kGuessLeaves leaves; each part in no root is one of them.
// Local.
Guess guess_cuts(const SortedSample& sample, const PartitionOptions& options, const GuessRoots& below);

// The guess of rank 0, which alone has a sample, on every rank. Collective (one gather).
Guess share_guess(comm::Comm& comm, const SortedSample& sample, const PartitionOptions& options,
                  const GuessRoots& below);

}  // namespace rcb::partition
