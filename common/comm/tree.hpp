// A tree of ranks, for collectives of so many ranks that none can hear from all others.
#pragma once

#include <vector>

namespace rcb::comm {

// One rank's place in the tree whose root is rank 0. A rank and all below it are consecutive numbers, so what is
// gathered along the tree, a rank's own first and then that of its children in their order, is in the order of the
// ranks.
struct TreePlace {
  int parent = -1;  // -1: the root
  std::vector<int> children;
};

// fan_out: children of a rank at most, >= 2. The tree has about log(size) / log(fan_out) levels. Local.
TreePlace place_in_tree(int rank, int size, int fan_out);

}  // namespace rcb::comm
