#include "common/partition/search/outermost.hpp"

#include <algorithm>
#include <array>

#include "common/base/index.hpp"
#include "common/base/prefetch.hpp"
#include "common/comm/gather.hpp"
#include "common/partition/search/split_rule.hpp"

namespace rcb::partition {
namespace {

using geometry::Box;

// Outermost particles are gathered if the sample's stride is at most kGatherStrideMax: about one stride of particles
// lies beyond each face of a box. A rank sends at most about kGatheredStridesMax strides of particles for each box,
// since more than that mean that the sample is unusual.
constexpr std::uint64_t kGatherStrideMax = 32768;
constexpr std::uint64_t kGatheredStridesMax = 16;
constexpr std::size_t kAhead = 512;  // particles that are prefetched ahead

// The slots of the particles outside of all these boxes, about `most` of them at most; the last few particles are taken
// wherever they lie. Compiled twice: with AVX2's comparisons it takes half the time. The version is chosen while the
// program is loaded, which is before the thread sanitizer has started, hence not with it.
#if defined(__x86_64__) && !defined(__SANITIZE_THREAD__)
__attribute__((target_clones("avx2", "default")))
#endif
std::vector<std::size_t>
slots_beyond(const particles::ParticleView& particles, std::vector<Box> boxes, std::uint64_t most) {
  constexpr std::size_t kRowLanes = 4;
  constexpr std::size_t kRowsTogether = 16 * kRowLanes;
  using Lanes = double __attribute__((vector_size(32), aligned(8), may_alias));
  using Mask = std::int64_t __attribute__((vector_size(32)));
  const particles::Axes x = particles.all_axes();
  for (Box& box : boxes)
    for (std::size_t a = at(particles.dims); a < x.size(); ++a) {
      box.lo[a] = box.lo[0];
      box.hi[a] = box.hi[0];
    }
  std::vector<std::size_t> slots;
  std::size_t begin = 0;
  for (; begin + kRowsTogether <= particles.count && slots.size() < most; begin += kRowsTogether) {
    std::array<Mask, kRowsTogether / kRowLanes> beyond;
    beyond.fill(~Mask{});
    for (std::size_t a = 0; a < x.size(); ++a)
      for (std::size_t i = 0; i < kRowsTogether; i += 8) prefetch(x[a], begin + kAhead + i);
    for (const Box& box : boxes)
      for (std::size_t g = 0; g < beyond.size(); ++g) {
        Mask out{};
        for (std::size_t a = 0; a < x.size(); ++a) {
          const Lanes own = reinterpret_cast<const Lanes*>(x[a] + begin)[g];
          out |= (own < box.lo[a]) | (own > box.hi[a]);
        }
        beyond[g] &= out;
      }
    Mask any{};
    for (const Mask& mask : beyond) any |= mask;
    if ((any[0] | any[1] | any[2] | any[3]) == 0) continue;
    for (std::size_t i = 0; i < kRowsTogether; ++i)
      if (beyond[i / kRowLanes][i % kRowLanes] != 0) slots.push_back(begin + i);
  }
  for (; begin < particles.count && slots.size() < most; ++begin) slots.push_back(begin);
  return slots;
}

// Whether particles beyond the sampled ones may make another axis than axes[0] the longest; axes: in the order of the
// sampled extents.
bool is_open(const SortedSample& sample, const AxisOrder& axes, double overhang) {
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
std::vector<Box> boxes_if_open(SortedSample sample, const PartitionOptions& options, int dims) {
  const AxisOrder axes = geometry::order_by_extent(sample.extents(sample.all()), dims);
  if (!is_open(sample, axes, options.limits.buckets.overhang)) return {};
  const double share = SplitRule(options, dims).left_share({0, 0, options.parts});
  const auto left = static_cast<std::size_t>(share * static_cast<double>(sample.all().size()));
  const SortedSample::Halves halves = sample.split(sample.all(), at(axes[0]), left);
  return {sample.box(halves.left), sample.box(halves.right)};
}

}  // namespace

void gather_outermost_if_open(comm::Comm& comm, const particles::ParticleView& particles,
                              const PartitionOptions& options, std::uint64_t stride, SortedSample& sample,
                              PartitionResult& spent) {
  // Hysteresis decides where extents hardly differ.
  const bool kept = options.previous != nullptr && options.axis_hysteresis > 1;
  if (kept || options.method != Method::rcb || stride > kGatherStrideMax) return;
  const std::vector<Box> own = comm.rank() == 0 ? boxes_if_open(sample, options, particles.dims) : std::vector<Box>();
  const Buffer<Box> boxes = comm::values_of_first<Box>(comm, own);
  ++spent.reductions;
  if (boxes.size() == 0) return;
  const std::uint64_t most = kGatheredStridesMax * boxes.size() * (stride + 64);
  sample.set_outermost(gather_sample(comm, particles, slots_beyond(particles, {boxes.begin(), boxes.end()}, most)));
  ++spent.reductions;
  spent.traffic += {particles.count, particles.count * at(particles.dims) * sizeof(double)};
}

}  // namespace rcb::partition
