// Recut: which subtrees are to be cut again, where not the whole tree is.
#pragma once

#include <vector>

#include "common/partition/cut_tree.hpp"
#include "common/partition/load.hpp"

namespace rcb::partition {

// The smallest subtrees whose new cuts bring every part's error below `wanted`, as their loads tell it: inside of one,
// each part gets its share of what the subtree holds. Apart from each other, ascending; the root alone where no less
// does, and for bands, whose cuts are one order. Empty where no part's error reaches `wanted`. Local.
std::vector<NodeRange> smallest_roots(const CutTree& tree, const LoadSummary& loads, double wanted);

}  // namespace rcb::partition
