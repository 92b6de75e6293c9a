// Settled: particles that a search doesn't look at, since nothing suggests that they leave their part: how many of each
// part, and where. Of all ranks, the same on each.
//
// Invariants
// 1. Boxes are exact: a settled particle lies on each face. So a node's extents are those of its records and these
// boxes.
// 2. A cut whose axis keeps all settled particles of the left parts strictly below it, and all of the right ones
//    strictly above, is the cut that a search among all particles finds.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "common/base/wide.hpp"
#include "common/geometry/box.hpp"

namespace rcb::partition {

struct Settled {
  std::vector<std::uint64_t> counts_upto;  // [parts + 1]: of parts [0, p)
  std::vector<u128> weights_upto;          // likewise; empty where weights don't count
  std::vector<geometry::Box> boxes;        // [parts]

  std::uint64_t count(int first, int last) const {
    return counts_upto[static_cast<std::size_t>(last)] - counts_upto[static_cast<std::size_t>(first)];
  }
  u128 weight(int first, int last) const {
    if (weights_upto.empty()) return 0;
    return weights_upto[static_cast<std::size_t>(last)] - weights_upto[static_cast<std::size_t>(first)];
  }
  geometry::Box box(int first, int last) const {
    geometry::Box all;
    for (int p = first; p < last; ++p) all.extend(boxes[static_cast<std::size_t>(p)]);
    return all;
  }
};

}  // namespace rcb::partition
