#include "common/comm/tree.hpp"

#include <algorithm>
#include <cstdint>

#include "common/base/check.hpp"

namespace rcb::comm {

TreePlace place_in_tree(int rank, int size, int fan_out) {
  RCB_CHECK(rank >= 0 && rank < size && fan_out >= 2, "a rank of the tree");
  TreePlace place;
  // The ranks from `first` to, not including, `last` are a subtree.
  std::int64_t first = 0;
  std::int64_t last = size;
  for (;;) {
    const std::int64_t below = last - first - 1;
    const std::int64_t groups = std::min<std::int64_t>(fan_out, below);
    const auto begin = [&, start = first + 1](std::int64_t group) { return start + below * group / groups; };
    if (rank == first) {
      for (std::int64_t group = 0; group < groups; ++group) place.children.push_back(static_cast<int>(begin(group)));
      return place;
    }
    place.parent = static_cast<int>(first);
    std::int64_t group = 0;
    while (begin(group + 1) <= rank) ++group;
    last = begin(group + 1);
    first = begin(group);
  }
}

}  // namespace rcb::comm
