#include "common/partition/sample/outermost.hpp"

#include <algorithm>
#include <bit>
#include <span>
#include <vector>

#include "common/base/index.hpp"
#include "common/base/prefetch.hpp"
#include "common/comm/gather.hpp"
#include "common/partition/kernels/kernels.hpp"
#include "common/partition/rules/split_rule.hpp"

namespace rcb::partition {
namespace {

using geometry::Box;

// Outermost particles are gathered if the sample's stride is at most kOutermostStrideMax: about one stride of particles
// lies beyond each face of a box. A rank sends at most about kOutermostStridesMax strides of particles for each box,
// since more than that mean that the sample is unusual.
constexpr std::uint64_t kOutermostStrideMax = 32768;
constexpr std::uint64_t kOutermostStridesMax = 16;
constexpr std::size_t kPrefetched = 512;  // particles that are prefetched ahead

// The slots of the particles outside of all these boxes, about `most` of them at most; the last few particles are taken
// wherever they lie.
std::vector<std::size_t> slots_outside(const particles::ParticleView& particles, std::span<const Box> boxes,
                                       std::uint64_t most) {
  const auto outside = kernels().outside;
  std::vector<Bounds> bounds;
  for (const Box& box : boxes) bounds.push_back(Bounds::of(box, particles.dims));
  std::vector<std::size_t> slots;
  std::size_t begin = 0;
  for (; begin + kBlock <= particles.count && slots.size() < most; begin += kBlock) {
    const Axes x = particles.all_axes(begin);
    for (const double* const own : x)
      for (std::size_t i = 0; i < kBlock; i += 8) prefetch(own, kPrefetched + i);
    std::uint64_t beyond = ~std::uint64_t{0};
    for (const Bounds& box : bounds) beyond &= outside(x, box);
    for (; beyond != 0; beyond &= beyond - 1) slots.push_back(begin + at(std::countr_zero(beyond)));
  }
  for (; begin < particles.count && slots.size() < most; ++begin) slots.push_back(begin);
  return slots;
}

// Whether particles beyond the sampled ones may make another axis than axes[0] the longest; axes: in the order of the
// sampled extents.
bool longest_is_open(const SortedSample& sample, const AxisOrder& axes, double overhang) {
  const SortedSample::Range all = sample.all();
  if (all.size() == 0 || sample.sample().dims < 2) return false;
  const Point extents = sample.extents(all);
  const std::size_t last = all.size() - 1;
  const std::size_t ninth = std::min<std::size_t>(8, last);
  const auto second = at(axes[1]);
  const double beyond = geometry::extent(sample.x(all, second, 0), sample.x(all, second, ninth)) +
                        geometry::extent(sample.x(all, second, last - ninth), sample.x(all, second, last));
  return extents[second] + overhang * beyond > extents[at(axes[0])];
}

// The boxes of a sample's particles on either side of the root's cut, if the longest axis is open; else none.
std::vector<Box> halves_if_open(SortedSample sample, const PartitionOptions& options, int dims) {
  const AxisOrder axes = geometry::order_by_extent(sample.extents(sample.all()), dims);
  if (!longest_is_open(sample, axes, options.tuning.sample.overhang)) return {};
  const double share = SplitRule(options, dims).left_share({0, 0, options.parts});
  const auto left = static_cast<std::size_t>(share * static_cast<double>(sample.all().size()));
  const SortedSample::Halves halves = sample.split(sample.all(), at(axes[0]), left);
  return {sample.box(halves.left), sample.box(halves.right)};
}

}  // namespace

void gather_outermost_if_open(comm::Comm& comm, const particles::ParticleView& particles,
                              const PartitionOptions& options, std::uint64_t stride, SortedSample& sample,
                              SearchCost& cost) {
  // Hysteresis decides where extents hardly differ.
  const bool kept = options.previous != nullptr && options.axis_hysteresis > 1;
  if (kept || options.method != Method::rcb || stride > kOutermostStrideMax) return;
  const std::vector<Box> own = comm.rank() == 0 ? halves_if_open(sample, options, particles.dims) : std::vector<Box>();
  const Buffer<Box> boxes = comm::values_of_first<Box>(comm, own);
  ++cost.reductions;
  if (boxes.size() == 0) return;
  const std::uint64_t most = kOutermostStridesMax * boxes.size() * (stride + 64);
  sample.set_outermost(gather_sample(comm, particles, slots_outside(particles, boxes.span(), most)));
  ++cost.reductions;
  cost.reads += particles.count;
  cost.bytes += particles.count * at(particles.dims) * sizeof(double);
}

}  // namespace rcb::partition
