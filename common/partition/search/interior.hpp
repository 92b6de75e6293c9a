// Interior: particles that an incremental search leaves out, since they are expected to stay in their part: how many
// each part has, and their bounding boxes. Over all ranks, the same on each.
//
// Invariants
// 1. Boxes are exact: an interior particle lies on each face. So a node's extents follow from its quantised points and
//    these boxes.
// 2. If a cut keeps all interior particles of the left parts strictly below it, and all those of the right parts
//    strictly above, it is the cut that a search among all particles finds. Their boxes tell that.
#pragma once

#include <cstdint>
#include <vector>

#include "common/base/wide.hpp"
#include "common/geometry/box.hpp"

namespace rcb::partition {

struct Interior {
  std::vector<std::uint64_t> count_prefix;  // [parts + 1]: particles in parts [0, p)
  std::vector<u128> weight_prefix;          // likewise; empty where weights don't count
  std::vector<geometry::Box> boxes;         // [parts]
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
