// A part's box grows with the interior particles that are found. Almost all particles lie in their part's box as it is
// already, and this one comparison shows that they are interior, since the box lies in the inner region; only the
// others are looked at one by one.
#include "common/partition/incremental/classify_interior.hpp"

#include <algorithm>
#include <array>
#include <bit>

#include "common/base/cpu.hpp"
#include "common/base/prefetch.hpp"
#include "common/partition/incremental/boundary_list.hpp"
#include "common/partition/search/four_points.hpp"

namespace rcb::partition {
namespace {

using particles::kBlock;
constexpr std::size_t kLanes = 4;
// Particles that are prefetched ahead: the work on those of a block that need it, whose branches depend on data, would
// otherwise wait for memory.
constexpr std::size_t kParticlesAhead = 16 * kBlock;

// One cache line. Lanes beyond the last axis are unbounded.
struct alignas(64) Bounds {
  std::array<double, kLanes> lo;
  std::array<double, kLanes> hi;
};

// The same of few parts, by axis, for looking up eight at once.
struct alignas(64) FewBounds {
  static constexpr std::size_t kParts = 16;
  std::array<std::array<double, kParts>, geometry::kDimsMax> lo;
  std::array<std::array<double, kParts>, geometry::kDimsMax> hi;
};

#if defined(__x86_64__)
[[gnu::target(RCB_AVX512), gnu::always_inline]] inline __m512d of_parts(
    const std::array<double, FewBounds::kParts>& bounds, __m512i part) {
  return _mm512_permutex2var_pd(_mm512_load_pd(bounds.data()), part, _mm512_load_pd(bounds.data() + 8));
}
#endif

class Pass {
 public:
  Pass(const particles::ParticleView& particles, const particles::BlockRanges* blocks,
       std::span<const std::int32_t> part, std::span<const geometry::Box> inner, OwnParts own, std::size_t boundary_max,
       OwnInterior& out)
      : particles_(particles),
        blocks_(blocks),
        part_(part),
        own_parts_(inner.size()),
        first_(own.first),
        boundary_max_(boundary_max),
        x_(particles.all_axes()),
        boundary_(particles, part.data(), particles.count / 16, out) {
    Bounds unbounded;
    unbounded.lo.fill(-geometry::Box::kInfinity);
    unbounded.hi.fill(geometry::Box::kInfinity);
    Bounds empty = unbounded;
    for (std::size_t a = 0; a < axes(); ++a) std::swap(empty.lo[a], empty.hi[a]);
    inner_.assign(own_parts_ + 1, unbounded);
    inner_.back() = empty;
    box_.assign(own_parts_ + 1, empty);
    for (std::size_t p = 0; p < own_parts_; ++p) {
      std::copy_n(inner[p].lo.begin(), axes(), inner_[p].lo.begin());
      std::copy_n(inner[p].hi.begin(), axes(), inner_[p].hi.begin());
    }
#if defined(__x86_64__)
    few_ = has_avx512() && box_.size() <= FewBounds::kParts;
#endif
    for (std::size_t p = 0; p < box_.size() && few_; ++p) copy_box(p);
  }

  // Grows the boxes with some thousand particles from everywhere first. Otherwise sorted arrays would be slow: each
  // particle would lie outside of the box of those before it.
  void seed() {
    const std::size_t stride = std::max<std::size_t>(particles_.count / 4096, 1);
    for (std::size_t i = 0; i < particles_.count; i += stride)
      if (interior(i)) grow(i);
  }

  void run() {
    for (std::size_t begin = 0; begin < particles_.count && boundary_.size() <= boundary_max_; begin += kBlock) {
      const std::size_t count = std::min(kBlock, particles_.count - begin);
      const std::int32_t* const part = part_.data() + begin;
      std::int32_t other = 0;
      for (std::size_t i = 0; i < count; ++i) other |= part[i] ^ part[0];
      if (blocks_ != nullptr && other == 0 && stays(begin / kBlock, index_of(part[0]))) continue;
      const Axes x = particles_.all_axes(begin);
      for (const double* axis : x)
        for (std::size_t i = 0; i < kBlock; i += 8) prefetch(axis, kParticlesAhead + i);
      const std::uint64_t beyond =
          other == 0 ? beyond_same(x, box_[index_of(part[0])], count) : beyond_own(x, part, count);
      const std::uint64_t inside = beyond == 0 ? 0 : interior_of(begin, beyond);
      for (std::uint64_t left = inside; left != 0; left &= left - 1)
        grow(begin + static_cast<std::size_t>(std::countr_zero(left)));
      if (beyond != inside) boundary_.append(begin, beyond & ~inside);
    }
    boundary_.finish(boundary_max_);
  }

  geometry::Box box(std::size_t p) const {
    geometry::Box box;
    std::copy_n(box_[p].lo.begin(), axes(), box.lo.begin());
    std::copy_n(box_[p].hi.begin(), axes(), box.hi.begin());
    return box;
  }

 private:
  std::size_t axes() const { return static_cast<std::size_t>(particles_.dims); }
  // The index of a part's bounds. Parts of other ranks share the last one, which stays empty.
  std::size_t index_of(std::int32_t part) const {
    return std::min<std::size_t>(static_cast<std::uint32_t>(part - first_), own_parts_);
  }

  bool interior(std::size_t i) const {
    const Bounds& inner = inner_[index_of(part_[i])];
    bool inside = true;
    for (std::size_t a = 0; a < x_.size(); ++a) inside &= (x_[a][i] > inner.lo[a]) & (x_[a][i] < inner.hi[a]);
    return inside;
  }
  // Makes the box of a particle's part hold it.
  void grow(std::size_t i) {
    grow(index_of(part_[i]), [&](std::size_t a) { return particles::Range{x_[a][i], x_[a][i]}; });
  }
  template <typename RangeOnAxis>
  void grow(std::size_t p, const RangeOnAxis& range_on) {
    for (std::size_t a = 0; a < axes(); ++a) {
      box_[p].lo[a] = std::min(box_[p].lo[a], range_on(a).lo);
      box_[p].hi[a] = std::max(box_[p].hi[a], range_on(a).hi);
    }
    if (few_) copy_box(p);
  }
  void copy_box(std::size_t p) {
    for (std::size_t a = 0; a < x_.size(); ++a) {
      few_boxes_.lo[a][p] = box_[p].lo[a];
      few_boxes_.hi[a][p] = box_[p].hi[a];
    }
  }

  // True if the ranges of a block of part p show that all its particles are interior; then p's box grows by the block.
  bool stays(std::size_t block, std::size_t p) {
    bool inside = true;
    for (std::size_t a = 0; a < axes() && inside; ++a)
      inside = blocks_->of[a][block].strictly_inside(inner_[p].lo[a], inner_[p].hi[a]);
    if (inside) grow(p, [&](std::size_t a) { return blocks_->of[a][block]; });
    return inside;
  }

  // The particles of a block, one bit each, that lie outside of these bounds; in beyond_own, outside of their own
  // part's.
  std::uint64_t beyond_same(const Axes& x, const Bounds& box, std::size_t count) const {
#if defined(__x86_64__)
    if (avx2_) return beyond_same_avx2(x, box, count);
#endif
    std::uint64_t beyond = 0;
    for (std::size_t i = 0; i < count; ++i) beyond |= is_beyond(x, box, i) << i;
    return beyond;
  }
  std::uint64_t beyond_own(const Axes& x, const std::int32_t* part, std::size_t count) const {
#if defined(__x86_64__)
    if (few_) return beyond_few_avx512(x, part, count);
    if (avx2_) return beyond_own_avx2(x, part, count);
#endif
    std::uint64_t beyond = 0;
    for (std::size_t i = 0; i < count; ++i) beyond |= is_beyond(x, box_[index_of(part[i])], i) << i;
    return beyond;
  }
  // Those of `which`, of the block that begins here, that are interior. Without branches: most of them lie on the
  // boundary, but not all.
  std::uint64_t interior_of(std::size_t begin, std::uint64_t which) const {
#if defined(__x86_64__)
    if (avx2_) return interior_of_avx2(begin, which);
#endif
    std::uint64_t inside = 0;
    for (; which != 0; which &= which - 1) {
      const auto k = static_cast<std::size_t>(std::countr_zero(which));
      inside |= std::uint64_t{interior(begin + k) ? 1U : 0U} << k;
    }
    return inside;
  }
  static std::uint64_t is_beyond(const Axes& x, const Bounds& box, std::size_t i) {
    bool in = true;
    for (std::size_t a = 0; a < x.size(); ++a) in &= (x[a][i] >= box.lo[a]) & (x[a][i] <= box.hi[a]);
    return in ? 0U : 1U;
  }

#if defined(__x86_64__)
  // Four particles at a time, one axis after the other.
  [[gnu::target("avx2")]] static std::uint64_t beyond_same_avx2(const Axes& x, const Bounds& box, std::size_t count) {
    std::uint64_t beyond = 0;
    std::size_t i = 0;
    for (; i + kLanes <= count; i += kLanes) {
      __m256d in = _mm256_castsi256_pd(_mm256_set1_epi64x(-1));
      for (std::size_t a = 0; a < x.size(); ++a) {
        const __m256d value = _mm256_loadu_pd(x[a] + i);
        in = _mm256_and_pd(in, _mm256_cmp_pd(value, _mm256_set1_pd(box.lo[a]), _CMP_GE_OQ));
        in = _mm256_and_pd(in, _mm256_cmp_pd(value, _mm256_set1_pd(box.hi[a]), _CMP_LE_OQ));
      }
      beyond |= static_cast<std::uint64_t>(_mm256_movemask_pd(in) ^ 0xF) << i;
    }
    for (; i < count; ++i) beyond |= is_beyond(x, box, i) << i;
    return beyond;
  }
  // Four particles at a time, each with all axes in one vector.
  [[gnu::target("avx2")]] std::uint64_t beyond_own_avx2(const Axes& x, const std::int32_t* part,
                                                        std::size_t count) const {
    const Bounds* const bounds = box_.data();
    const auto last = static_cast<std::uint32_t>(own_parts_);
    std::uint64_t beyond = 0;
    std::size_t i = 0;
    for (; i + kLanes <= count; i += kLanes) {
      __m256d point[kLanes];
      load_four_points(x, i, point);
      __m256d in[kLanes];
      for (std::size_t k = 0; k < kLanes; ++k) {
        const Bounds& box = bounds[std::min(static_cast<std::uint32_t>(part[i + k] - first_), last)];
        in[k] = _mm256_and_pd(_mm256_cmp_pd(point[k], _mm256_load_pd(box.lo.data()), _CMP_GE_OQ),
                              _mm256_cmp_pd(point[k], _mm256_load_pd(box.hi.data()), _CMP_LE_OQ));
      }
      // A particle is inside if it is on all axes: transposed, so that one mask tells it of all four, without a branch.
      const __m256d xy = _mm256_and_pd(_mm256_unpacklo_pd(in[0], in[1]), _mm256_unpackhi_pd(in[0], in[1]));
      const __m256d zw = _mm256_and_pd(_mm256_unpacklo_pd(in[2], in[3]), _mm256_unpackhi_pd(in[2], in[3]));
      const __m256d all = _mm256_and_pd(_mm256_permute2f128_pd(xy, zw, 0x20), _mm256_permute2f128_pd(xy, zw, 0x31));
      beyond |= static_cast<std::uint64_t>(_mm256_movemask_pd(all) ^ 0xF) << i;
    }
    for (; i < count; ++i) beyond |= is_beyond(x, bounds[index_of(part[i])], i) << i;
    return beyond;
  }
  // Eight at a time, where the boxes of all parts fit in registers.
  [[gnu::target(RCB_AVX512)]] std::uint64_t beyond_few_avx512(const Axes& x, const std::int32_t* part,
                                                              std::size_t count) const {
    const __m256i first = _mm256_set1_epi32(first_);
    const __m256i last = _mm256_set1_epi32(static_cast<int>(own_parts_));
    std::uint64_t beyond = 0;
    for (std::size_t i = 0; i < count; i += 8) {
      const auto some = static_cast<__mmask8>(count - i < 8 ? (1U << (count - i)) - 1 : 0xFF);
      const __m256i own = _mm256_sub_epi32(_mm256_maskz_loadu_epi32(some, part + i), first);
      const __m512i index = _mm512_cvtepu32_epi64(_mm256_min_epu32(own, last));
      __mmask8 in = some;
      for (std::size_t a = 0; a < x.size(); ++a) {
        const __m512d value = _mm512_maskz_loadu_pd(some, x[a] + i);
        in = _mm512_mask_cmp_pd_mask(in, value, of_parts(few_boxes_.lo[a], index), _CMP_GE_OQ);
        in = _mm512_mask_cmp_pd_mask(in, value, of_parts(few_boxes_.hi[a], index), _CMP_LE_OQ);
      }
      beyond |= std::uint64_t{static_cast<__mmask8>(some & ~in)} << i;
    }
    return beyond;
  }
  [[gnu::target(RCB_AVX2)]] std::uint64_t interior_of_avx2(std::size_t begin, std::uint64_t which) const {
    const Axes x = particles_.all_axes(begin);
    const std::int32_t* const part = part_.data() + begin;
    const Bounds* const inner = inner_.data();
    std::uint64_t inside = 0;
    for (; which != 0; which &= which - 1) {
      const auto k = static_cast<std::size_t>(std::countr_zero(which));
      const Bounds& own = inner[index_of(part[k])];
      const __m256d point = _mm256_setr_pd(x[0][k], x[1][k], x[2][k], 0);
      const __m256d in = _mm256_and_pd(_mm256_cmp_pd(point, _mm256_load_pd(own.lo.data()), _CMP_GT_OQ),
                                       _mm256_cmp_pd(point, _mm256_load_pd(own.hi.data()), _CMP_LT_OQ));
      inside |= std::uint64_t{_mm256_movemask_pd(in) == 0xF} << k;
    }
    return inside;
  }
#endif

  [[maybe_unused]] const bool avx2_ = has_avx2();
  const particles::ParticleView& particles_;
  const particles::BlockRanges* blocks_;
  std::span<const std::int32_t> part_;
  std::size_t own_parts_;
  std::int32_t first_;
  std::size_t boundary_max_;
  Axes x_;
  BoundaryList boundary_;
  std::vector<Bounds> inner_;  // [own parts + 1]: inner regions
  std::vector<Bounds> box_;    // [own parts + 1]: of the interior particles so far
  bool few_ = false;           // the same stands in few_boxes_
  FewBounds few_boxes_{};
};

}  // namespace

particles::ParticleView OwnInterior::view(const particles::ParticleView& of) const {
  particles::ParticleView view = boundary.view();
  view.count = slot.size();
  view.id = of.id;
  view.id_slot = slot.data();
  return view;
}

OwnInterior classify_interior(const particles::ParticleView& particles, const particles::BlockRanges* blocks,
                              std::span<const std::int32_t> part, std::span<const geometry::Box> inner, OwnParts own,
                              std::size_t boundary_max) {
  OwnInterior out;
  Pass pass(particles, blocks, part, inner, own, boundary_max, out);
  if (blocks == nullptr) pass.seed();  // with blocks not needed: those that stay as a whole soon make the boxes grow
  pass.run();
  for (std::size_t p = 0; p < inner.size(); ++p) out.boxes.push_back(pass.box(p));
  return out;
}

}  // namespace rcb::partition
