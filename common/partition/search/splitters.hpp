// Splitters: the upper cuts of a sample's tree, which tell where the set's own cuts are expected.
#pragma once

#include <array>
#include <cstdint>
#include <limits>

#include "common/comm/comm.hpp"
#include "common/partition/search/request.hpp"
#include "common/partition/search/sorted_sample.hpp"

namespace rcb::partition {

// Where a node's cut is expected: across this axis, in [least, most].
struct ExpectedCut {
  int axis = -1;  // < 0: not known: the tree has no such node, or too few sampled particles lie there
  double least = -geometry::Box::kInfinity;
  double most = geometry::Box::kInfinity;
  double likeliest = -geometry::Box::kInfinity;  // set by inner_regions() alone

  bool anywhere() const { return least == -geometry::Box::kInfinity && most == geometry::Box::kInfinity; }
};

// By the sampled particles of a node whose left side takes this share. Local.
ExpectedCut expect_cut(const SortedSample& sample, const SortedSample::Range& node, int axis, double share,
                       const SearchLimits& limits);

// A complete binary tree: node k has the children 2k + 1 and 2k + 2. Trivially copyable: it is sent as it is.
struct Splitters {
  static constexpr std::size_t kLevels = 6;
  static constexpr std::size_t kNodes = (std::size_t{1} << kLevels) - 1;

  // Rounded coordinates. Those from `least` to `most` are where the cut is expected, greater ones go right.
  struct Node {
    float least = std::numeric_limits<float>::infinity();
    float most = std::numeric_limits<float>::infinity();
    std::int32_t axis = 0;
  };

  std::array<Node, kNodes> nodes;
  RoundedAxes rounded;
  std::array<ExpectedCut, kNodes> expected;
};

// Local.
Splitters find_splitters(SortedSample sample, const PartitionOptions& options, int dims);

// Those of rank 0's sample, on every rank. Collective (one gather).
Splitters share_splitters(comm::Comm& comm, const SortedSample& sample, const PartitionOptions& options, int dims);

}  // namespace rcb::partition
