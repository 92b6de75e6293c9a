// Guess: the cuts that are expected, from a sample of the particles, before any other particle is looked at.
//
// Invariants
// 1. A wrong guess costs time only: the search verifies what it relies on (interior.hpp).
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "common/geometry/box.hpp"
#include "common/partition/search/interior.hpp"
#include "common/partition/search/request.hpp"
#include "common/partition/search/sorted_sample.hpp"
#include "common/partition/search/split_rule.hpp"

namespace rcb::partition {

// Cuts of at most so many parts are guessed: the tables of one pass over all particles have room for these
// (guess_tables.hpp).
inline constexpr std::size_t kGuessParts = 8;
inline constexpr std::size_t kGuessLevels = 3;

// Trivially copyable: it is sent as it is.
struct Guess {
  int parts = 1;
  std::array<KeyBracket, kGuessParts - 1> brackets{};  // [inner nodes]; unknown: nothing is guessed from this node on
  // [parts]: inner regions (brackets.hpp). The parts below a node without a bracket share one region, which stands
  // at the first of them.
  std::array<geometry::Box, kGuessParts> inner{};
  std::array<geometry::Box, kGuessParts> seen{};  // [parts]: boxes of the sampled particles strictly inside of `inner`
  bool tied = false;                              // several sampled particles lie on one face of such a box
  bool found = false;                             // enough cuts
  // Set, and nothing is guessed, if the sample leaves the root's longest axis open, or, where whole keys count, the
  // order of the others. The particles outside of both sides' boxes would tell.
  bool open = false;
  std::array<geometry::Box, 2> sides{};  // the boxes of the sampled particles on either side of the root's expected cut
};

// Nodes whose cuts are to be guessed.
struct GuessRoots {
  const CutTree& tree;                      // whose cuts above the roots are exact
  const std::vector<NodeRange>& roots;      // none below another
  const std::vector<geometry::Box>& boxes;  // [roots]: of their particles; empty: not known
  const SplitRule& rule;                    // made from all particles, if the tree's root isn't among the roots
  const Guess* before = nullptr;            // the guess that left them uncut; null: none was made
};

// Guesses the cuts below some nodes. Local.
Guess guess_cuts(const SortedSample& sample, const PartitionOptions& options, const GuessRoots& below);

}  // namespace rcb::partition
