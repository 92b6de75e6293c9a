// Interior: particles that an incremental search leaves out, since they are expected to stay in their part: how many
// each part has, and their bounding boxes. Over all ranks, the same on each.
//
// Invariants
// 1. Boxes are exact: an interior particle lies on each face. So a node's extents follow from its quantised points and
//    these boxes.
// 2. If a cut keeps all interior particles of the left parts strictly below it, and all those of the right parts
//    strictly above, it is the cut that a search among all particles finds. Their boxes tell that where their
//    coordinates on the cut's axis do; where many lie on its plane, the bracket of their keys.
#pragma once

#include <cstdint>
#include <vector>

#include "common/base/wide.hpp"
#include "common/geometry/box.hpp"
#include "common/cuts/key.hpp"

namespace rcb::partition {

using cuts::AxisOrder;
using cuts::Id;
using cuts::Key;
using cuts::key_between;
using cuts::key_of;
using cuts::Point;

// Where a node's cut is expected. All interior particles of its left parts have lesser keys than `least`, all those of
// its right parts greater ones than `most`.
struct KeyBracket {
  bool known = false;  // else the node is left uncut
  AxisOrder axes{0, 1, 2};
  Key least;
  Key most;
  bool whole = false;  // else the first coordinate alone counts
};

struct Interior {
  std::vector<std::uint64_t> count_prefix;  // [parts + 1]: particles in parts [0, p)
  std::vector<u128> weight_prefix;          // likewise; empty where weights don't count
  std::vector<geometry::Box> boxes;         // [parts]
  std::vector<KeyBracket> brackets;         // [inner nodes]; empty: not known
  geometry::Box boundary;                   // of the boundary particles, which are those that are searched

  std::uint64_t count(int first, int last) const {
    return count_prefix[static_cast<std::size_t>(last)] - count_prefix[static_cast<std::size_t>(first)];
  }
  u128 weight(int first, int last) const {
    if (weight_prefix.empty()) return 0;
    return weight_prefix[static_cast<std::size_t>(last)] - weight_prefix[static_cast<std::size_t>(first)];
  }
  geometry::Box box(int first, int last) const {
    geometry::Box all;
    for (int p = first; p < last; ++p) all.extend(boxes[static_cast<std::size_t>(p)]);
    return all;
  }
};

}  // namespace rcb::partition
