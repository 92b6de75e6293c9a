// Recut: which subtrees are to be cut again if not the whole tree.
#pragma once

#include <vector>

#include "common/cuts/cut_tree.hpp"
#include "common/partition/balance/load.hpp"

namespace rcb::partition {

using cuts::CutTree;
using cuts::Method;
using cuts::NodeRange;

// The smallest subtrees whose new cuts bring every part's error below `wanted`, judging by the loads: new cuts give
// each part of a subtree its share of the subtree's load. Ascending, none below another. The root alone if nothing less
// suffices, and always for bands, whose cuts form one sequence. Empty if no part's error reaches `wanted`. Local.
std::vector<NodeRange> smallest_roots(const CutTree& tree, const LoadSummary& loads, double wanted);

}  // namespace rcb::partition
