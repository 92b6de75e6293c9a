// A guess as tables, in which a pass over all particles looks up the leaf of each.
//
// Most particles lie in the box of the sampled particles of their part. Coordinates rounded to float show that:
// rounding keeps the order, so what is strictly between two rounded bounds lies between the bounds. Only the others are
// compared by their whole keys.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "common/partition/incremental/guess.hpp"
#include "common/partition/search/rounded_axes.hpp"

namespace rcb::partition {

// The guessed tree, level by level. A node k that is cut has the children next[k] and next[k] + 1 on the level below.
// One that isn't goes down as it is: its only child, next[k], is the same node again.
struct GuessTables {
  static constexpr std::size_t kLeaves = kGuessParts;
  using Floats = std::array<float, kLeaves>;
  using Integers = std::array<std::int32_t, kLeaves>;
  using Words = std::array<std::int64_t, kLeaves>;
  using Doubles = std::array<double, kLeaves>;

  // The cuts of a level's nodes, by word and node, for comparing whole keys; the words are integers that compare as
  // what they stand for does. A particle whose key is neither less than `least` nor greater than `most` is a boundary
  // particle.
  struct alignas(64) Keys {
    std::array<Words, geometry::kDimsMax> axis{};  // whose coordinate the word is; behind them comes the id
    std::array<Words, geometry::kDimsMax + 1> least{};
    std::array<Words, geometry::kDimsMax + 1> most{};
    Words next{};
    bool whole = false;  // else the first word of each key alone counts
  };
  // The words of one node, so laid out that all four are compared at once: the last word first.
  struct alignas(32) Step {
    std::array<std::int64_t, geometry::kDimsMax + 1> least{};
    std::array<std::int64_t, geometry::kDimsMax + 1> most{};
    std::array<std::int32_t, 8> order{};  // the words as halves of {x, y, z, id}
    std::int32_t next = 0;
  };

  // roots: as for classify_guessed().
  GuessTables(const Guess& guess, std::span<const NodeRange> roots, int dims);

  // The box of a leaf's interior particles so far.
  geometry::Box box(std::size_t leaf) const;
  // Widens it to hold a particle.
  void extend(std::size_t leaf, const geometry::Point& position);

  std::array<Keys, kGuessLevels> keys;
  std::array<std::array<Step, kLeaves>, kGuessLevels> steps;  // the same, node by node
  alignas(64) Integers first{};                               // of each part so far: its node on the first level
  std::array<Integers, kGuessLevels> next{};
  // Rounded bounds of each cut's bracket; what is greater than the lesser one goes right. Where there is no cut, both
  // are infinite.
  std::array<Floats, kGuessLevels> least;
  std::array<Floats, kGuessLevels> most;
  std::array<Integers, kGuessLevels> on_y{};  // -1 where the cut's axis is the second one; else 0
  std::array<Integers, kGuessLevels> on_z{};  // likewise, the third one
  // By axis and leaf: the box of its interior particles so far; each face touches a particle of some rank.
  alignas(64) std::array<Doubles, geometry::kDimsMax> box_lo;
  std::array<Doubles, geometry::kDimsMax> box_hi;
  std::array<Floats, geometry::kDimsMax> lo;  // rounded (set_bounds())
  std::array<Floats, geometry::kDimsMax> hi;
  std::array<Doubles, geometry::kDimsMax> inner_lo;  // of its inner region
  std::array<Doubles, geometry::kDimsMax> inner_hi;
  // Coordinates in [sure_lo, sure_hi] are in the box and strictly inside the inner region: interior without a look at
  // keys.
  std::array<Doubles, geometry::kDimsMax> sure_lo;
  std::array<Doubles, geometry::kDimsMax> sure_hi;
  Integers part{};  // of each leaf
  RoundedAxes rounded;
  int dims = 3;
  bool tied_faces = false;  // many particles may lie on a box's faces, and rounded coordinates don't tell these
  bool below_root = false;  // each particle begins at the node of its part so far, not at the tree's root
  std::size_t levels = 0;   // with a cut
  std::size_t leaves = 0;

 private:
  struct Node {
    NodeRange range;
    bool ends;
    bool fixed;  // in no root
  };
  void fit_axes(const Guess& guess);
  std::vector<Node> add_roots(const Guess& guess, std::span<const NodeRange> roots);
  void add_cut(std::size_t level, std::size_t node, const KeyBracket& bracket);
  Step step(std::size_t level, std::size_t node) const;
  void add_leaf(std::size_t leaf, const Guess& guess, const Node& node);
  // Sets lo and hi of a leaf and an axis, so that a coordinate whose rounded value lies between them is certainly in
  // the box and the inner region. False if a coordinate on the box's face has the same float as one outside, so that
  // floats can't tell it.
  bool set_bounds(std::size_t leaf, std::size_t a);
};

}  // namespace rcb::partition
