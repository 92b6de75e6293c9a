#include "common/partition/search/splitters.hpp"

#include <cmath>

#include "common/base/index.hpp"
#include "common/comm/gather.hpp"
#include "common/partition/search/split_rule.hpp"

namespace rcb::partition {
namespace {

// Cuts a sample as the search cuts the set.
class SampleTree {
 public:
  SampleTree(SortedSample& sample, const PartitionOptions& options, int dims, Splitters& out)
      : sample_(sample), limits_(options.limits), rule_(options, dims), out_(out) {
    rule_.set_all(sample.all().size(), sample.extents(sample.all()));
    cut({0, 0, options.parts}, 0, sample.all());
  }

 private:
  void cut(const NodeRange& range, std::size_t node, const SortedSample::Range& own) {
    if (range.leaf() || node >= Splitters::kNodes || own.size() < 2) return;
    const Point extents = sample_.extents(own);
    const int axis = (*rule_.axes_of(range, {extents, extents}))[0];
    const double share = rule_.left_share(range);
    const ExpectedCut expected = expect_cut(sample_, own, axis, share, limits_);
    out_.expected[node] = expected;
    out_.nodes[node] = {out_.rounded(at(axis), expected.least), out_.rounded(at(axis), expected.most), axis};
    const auto left = static_cast<std::size_t>(share * static_cast<double>(own.size()));
    const SortedSample::Halves halves = sample_.split(own, at(axis), left);
    cut(range.left(), 2 * node + 1, halves.left);
    cut(range.right(), 2 * node + 2, halves.right);
  }

  SortedSample& sample_;
  const SearchLimits& limits_;
  SplitRule rule_;
  Splitters& out_;
};

}  // namespace

ExpectedCut expect_cut(const SortedSample& sample, const SortedSample::Range& node, int axis, double share,
                       const SearchLimits& limits) {
  const auto n = static_cast<double>(node.size());
  const double half_width = limits.bracket_sigmas * std::sqrt(share * (1 - share) * n) + limits.bracket_margin;
  const double least = std::floor(share * n - half_width);
  const double most = std::ceil(share * n + half_width);
  ExpectedCut expected{.axis = axis};
  if (least >= 0 && least < n) expected.least = sample.x(node, at(axis), static_cast<std::size_t>(least));
  if (most < n) expected.most = sample.x(node, at(axis), static_cast<std::size_t>(most));
  return expected;
}

Splitters find_splitters(SortedSample sample, const PartitionOptions& options, int dims) {
  Splitters splitters;
  splitters.rounded = sample.rounded();
  SampleTree(sample, options, dims, splitters);
  return splitters;
}

Splitters share_splitters(comm::Comm& comm, const SortedSample& sample, const PartitionOptions& options, int dims) {
  const Splitters own = comm.rank() == 0 ? find_splitters(sample, options, dims) : Splitters{};
  return comm::values_of_first<Splitters>(comm, {&own, 1})[0];
}

}  // namespace rcb::partition
