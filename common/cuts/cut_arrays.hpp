// A cut tree as plain arrays, the form in which it travels.
#pragma once

#include <cstdint>
#include <vector>

#include "common/base/status.hpp"
#include "common/cuts/cut_tree.hpp"

namespace rcb::cuts {

struct CutArrays {
  int dims = 3;
  Method method = Method::rcb;
  int parts = 1;
  std::vector<double> part_sizes;  // [parts], or empty: equal
  // By inner node, in preorder:
  std::vector<std::int32_t> axes;  // [parts - 1][dims]: the cut axis, then those that decide ties
  std::vector<double> at;  // [parts - 1][dims]: the key's coordinates in that order; 0 where the right side is empty
  std::vector<Id> id;      // [parts - 1]: the key's id; -1: the right side is empty
};

CutArrays arrays_of(const CutTree& tree);
// Errors: protocol_error, for arrays that aren't a tree's.
Result<CutTree> tree_of(const CutArrays& arrays);

}  // namespace rcb::cuts
