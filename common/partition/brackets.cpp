#include "common/partition/brackets.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numeric>

#include "common/base/buffer.hpp"
#include "common/partition/load.hpp"

namespace rcb::partition {
namespace {

constexpr double kInfinity = geometry::Box::kInfinity;
constexpr std::uint64_t kSharedSample = 4096;  // particles of all ranks together, which every rank gets
constexpr std::uint64_t kOwnSample = 8192;     // of each rank's own, for nodes that it holds alone

std::size_t at(int index) { return static_cast<std::size_t>(index); }

// Every stride-th particle, sorted by part.
class Sample {
 public:
  Sample(const particles::ParticleView& particles, std::span<const std::int32_t> part, std::uint64_t stride) {
    const std::size_t count = (particles.count + stride - 1) / stride;
    for (std::size_t a = 0; a < at(particles.dims); ++a) x_[a].resize(count);
    part_.resize(count);
    for (std::size_t k = 0; k < count; ++k) {
      for (std::size_t a = 0; a < at(particles.dims); ++a) x_[a][k] = particles.position[a][k * stride];
      part_[k] = part[k * stride];
    }
  }

  // Every rank's. Collective.
  void share(Comm& comm, int dims) {
    Buffer<std::byte> mine;
    for (std::size_t a = 0; a < at(dims); ++a) mine.append(std::as_bytes(x_[a].span()));
    mine.append(std::as_bytes(part_.span()));
    std::vector<std::byte> all;
    std::vector<std::size_t> sizes;
    comm.all_gather(mine.span(), all, sizes);
    for (auto& x : x_) x.clear();
    part_.clear();
    const std::byte* from = all.data();
    for (const std::size_t size : sizes) {
      const std::size_t count = size / (at(dims) * sizeof(double) + sizeof(std::int32_t));
      const auto take = [&](auto& values) {
        const std::size_t had = values.size();
        values.resize(had + count);
        if (count > 0) std::memcpy(values.data() + had, from, count * sizeof(values[0]));
        from += count * sizeof(values[0]);
      };
      for (std::size_t a = 0; a < at(dims); ++a) take(x_[a]);
      take(part_);
    }
  }

  void sort_by_part(int parts) {
    ends_.assign(at(parts) + 1, 0);
    for (const std::int32_t p : part_) ++ends_[at(p) + 1];
    std::partial_sum(ends_.begin(), ends_.end(), ends_.begin());
    order_.resize(part_.size());
    std::vector<std::size_t> next(ends_.begin(), ends_.end() - 1);
    for (std::size_t k = 0; k < part_.size(); ++k) order_[next[at(part_[k])]++] = static_cast<std::uint32_t>(k);
  }

  std::size_t count(int first, int last) const { return ends_[at(last)] - ends_[at(first)]; }
  // The coordinates of parts [first, last).
  void coordinates(int first, int last, std::size_t axis, std::vector<double>& out) const {
    out.clear();
    for (std::size_t k = ends_[at(first)]; k < ends_[at(last)]; ++k) out.push_back(x_[axis][order_[k]]);
  }

 private:
  std::array<Buffer<double>, geometry::kDimsMax> x_;
  Buffer<std::int32_t> part_;
  Buffer<std::uint32_t> order_;
  std::vector<std::size_t> ends_;
};

class Walk {
 public:
  Walk(const CutTree& tree, std::span<const double> loads, OwnParts own, const SearchLimits& limits,
       const Sample& shared, const Sample& mine, std::vector<geometry::Box>& out)
      : tree_(tree), own_(own), limits_(limits), shared_(shared), mine_(mine), out_(out) {
    upto_.assign(1, 0.0);
    for (const double load : loads) upto_.push_back(upto_.back() + load);
    size_upto_.assign(1, 0.0);
    for (int p = 0; p < tree.parts; ++p)
      size_upto_.push_back(size_upto_.back() + (tree.part_sizes.empty() ? 1.0 : tree.part_sizes[at(p)]));
  }

  void visit(const NodeRange& range, const geometry::Box& inner) {
    if (range.last <= own_.first || range.first >= own_.last) return;
    if (range.leaf()) {
      out_[at(range.first - own_.first)] = inner;
      return;
    }
    const Cut& cut = tree_.cuts[at(range.node)];
    const auto axis = at(cut.axes[0]);
    const auto [lo, hi] = bracket(range, cut, axis);
    geometry::Box left = inner;
    geometry::Box right = inner;
    left.hi[axis] = std::min(left.hi[axis], lo);
    right.lo[axis] = std::max(right.lo[axis], hi);
    visit(range.left(), left);
    visit(range.right(), right);
  }

 private:
  struct Bracket {
    double lo;
    double hi;
  };

  Bracket bracket(const NodeRange& range, const Cut& cut, std::size_t axis) {
    constexpr Bracket kAnywhere{-kInfinity, kInfinity};
    const bool alone = own_.first <= range.first && range.last <= own_.last;
    const Sample& sample = alone ? mine_ : shared_;
    const std::size_t all = sample.count(range.first, range.last);
    const double load = upto_[at(range.last)] - upto_[at(range.first)];
    if (cut.right_empty || all == 0 || !(load > 0)) return kAnywhere;
    const double share = (size_upto_[at(range.middle())] - size_upto_[at(range.first)]) /
                         (size_upto_[at(range.last)] - size_upto_[at(range.first)]);
    // Sampled particles that left has too many.
    const double excess =
        ((upto_[at(range.middle())] - upto_[at(range.first)]) / load - share) * static_cast<double>(all);
    const double margin = limits_.bracket_sigmas * std::sqrt(std::abs(excess)) + limits_.bracket_margin;
    sample.coordinates(range.first, range.middle(), axis, left_);
    sample.coordinates(range.middle(), range.last, axis, right_);
    return {coordinate(std::ceil(excess + margin)), coordinate(std::floor(excess - margin))};
  }

  // Of the sampled particle that stands so many places before (counted from 1) or, if not positive, behind the cut.
  double coordinate(double before) {
    const bool is_left = before > 0;
    std::vector<double>& side = is_left ? left_ : right_;
    const double place = is_left ? before - 1 : -before;
    if (place >= static_cast<double>(side.size())) return is_left ? -kInfinity : kInfinity;
    const auto nth = side.begin() + static_cast<std::ptrdiff_t>(place);
    if (is_left)
      std::nth_element(side.begin(), nth, side.end(), std::greater<>());
    else
      std::nth_element(side.begin(), nth, side.end());
    return *nth;
  }

  const CutTree& tree_;
  OwnParts own_;
  const SearchLimits& limits_;
  const Sample& shared_;
  const Sample& mine_;
  std::vector<geometry::Box>& out_;
  std::vector<double> upto_;
  std::vector<double> size_upto_;
  std::vector<double> left_;
  std::vector<double> right_;
};

}  // namespace

std::vector<geometry::Box> inner_regions(Comm& comm, const particles::ParticleView& particles,
                                         std::span<const std::int32_t> part, const CutTree& tree, std::uint64_t count,
                                         std::span<const double> loads, std::span<const NodeRange> roots, OwnParts own,
                                         const SearchLimits& limits) {
  const auto stride = [](std::uint64_t of, std::uint64_t wanted) { return std::max<std::uint64_t>(of / wanted, 1); };
  Sample shared(particles, part, stride(count, kSharedSample));
  shared.share(comm, particles.dims);
  shared.sort_by_part(tree.parts);
  Sample mine(particles, part, stride(particles.count, kOwnSample));
  mine.sort_by_part(tree.parts);
  std::vector<geometry::Box> inner(at(own.last - own.first), geometry::Box::unbounded());
  Walk walk(tree, loads, own, limits, shared, mine, inner);
  for (const NodeRange& root : roots) walk.visit(root, geometry::Box::unbounded());
  return inner;
}

}  // namespace rcb::partition
