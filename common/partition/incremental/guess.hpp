// Guess: the cuts that are expected, from a sample of the particles, before any other particle is looked at.
//
// Invariants
// 1. A wrong guess costs time only: the search verifies what it relies on (interior.hpp).
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "common/geometry/box.hpp"
#include "common/partition/incremental/sample.hpp"
#include "common/partition/search/interior.hpp"
#include "common/partition/search/request.hpp"

namespace rcb::partition {

// A guess has at most so many levels and leaves, which fit into the tables of one pass (classify_guessed.cpp).
inline constexpr int kGuessLevels = 3;
inline constexpr int kGuessLeaves = 8;

struct Guess {
  CutTree tree;                      // of each cut, the axis and the expected coordinate
  std::vector<std::uint8_t> ends;    // [inner nodes]: 1: nothing is guessed from this node on
  std::vector<KeyBracket> brackets;  // [inner nodes]
  std::vector<geometry::Box> inner;  // [parts]: inner regions (brackets.hpp); that of such a node is its first part's
  std::vector<geometry::Box> seen;   // [parts]: the sampled particles strictly inside of them
};

// Nodes whose cuts are to be guessed.
struct GuessRoots {
  CutTree tree;                      // whose cuts above the roots are exact
  std::vector<NodeRange> roots;      // none below another
  std::vector<geometry::Box> boxes;  // [roots]: of their particles; empty: not known
  const Guess* before = nullptr;     // the guess that left them uncut; null: none was made
};

// The guess below some nodes: at most kGuessLeaves leaves, the parts in no root among them. sample: one particle of
// each `stride`. outermost: all particles outside of the sampled ones' box; null: not known. axis_open: becomes true if
// an axis could not be told that `outermost` might tell. nullopt if no cut can be guessed. Local.
std::optional<Guess> guess_cuts(const Sample& sample, const Sample* outermost, const PartitionOptions& options,
                                const GuessRoots& below, bool& axis_open);

}  // namespace rcb::partition
