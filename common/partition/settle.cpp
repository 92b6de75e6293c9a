// A part's box grows with the particles that stay. Almost all lie within what it is already, and that one comparison
// says that they stay, since the box lies in the inner region; only the others are looked at one by one.
#include "common/partition/settle.hpp"

#include <algorithm>
#include <array>
#include <cstring>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace rcb::partition {
namespace {

constexpr std::size_t kBlock = 64;
constexpr std::uint64_t kAllInside = 0x0101010101010101U;
constexpr std::size_t kLanes = 4;

// One cache line; the lanes of no axis hold anything.
struct alignas(64) Bounds {
  std::array<double, kLanes> lo;
  std::array<double, kLanes> hi;
};

class Pass {
 public:
  Pass(const particles::ParticleView& particles, std::span<const std::int32_t> part,
       std::span<const geometry::Box> inner, OwnParts own, Buffer<std::uint64_t>& few)
      : particles_(particles), part_(part), inner_(inner), first_(own.first), few_(few) {
    Bounds none;
    none.lo.fill(-geometry::Box::kInfinity);
    none.hi.fill(geometry::Box::kInfinity);
    for (std::size_t a = 0; a < axes(); ++a) std::swap(none.lo[a], none.hi[a]);
    bounds_.assign(inner.size() + 1, none);
  }

  // Some thousand from everywhere first: then orders in which each particle lies beyond the ones before it cost no more
  // than others.
  void seed() {
    const std::size_t stride = std::max<std::size_t>(particles_.count / 4096, 1);
    for (std::size_t i = 0; i < particles_.count; i += stride) look(i);
    few_.clear();
  }

  void run() {
#if defined(__x86_64__)
    if (__builtin_cpu_supports("avx2")) return run_blocks<true>();
#endif
    run_blocks<false>();
  }

  geometry::Box box(std::size_t p) const {
    geometry::Box box;
    std::copy_n(bounds_[p].lo.begin(), axes(), box.lo.begin());
    std::copy_n(bounds_[p].hi.begin(), axes(), box.hi.begin());
    return box;
  }

 private:
  std::size_t axes() const { return static_cast<std::size_t>(particles_.dims); }
  // Of its bounds; all parts of other ranks share one, which holds nobody.
  std::size_t index(std::size_t i) const {
    const auto p = static_cast<std::uint32_t>(part_[i] - first_);
    return std::min<std::size_t>(p, inner_.size());
  }

  // One that the bounds so far don't hold.
  void look(std::size_t i) {
    const std::size_t p = index(i);
    bool inside = p < inner_.size();
    for (std::size_t a = 0; a < axes() && inside; ++a)
      inside = particles_.position[a][i] > inner_[p].lo[a] && particles_.position[a][i] < inner_[p].hi[a];
    if (!inside) {
      few_.push_back(i);
      return;
    }
    for (std::size_t a = 0; a < axes(); ++a) {
      bounds_[p].lo[a] = std::min(bounds_[p].lo[a], particles_.position[a][i]);
      bounds_[p].hi[a] = std::max(bounds_[p].hi[a], particles_.position[a][i]);
    }
  }

  template <bool kAvx2>
  void run_blocks() {
    // Axes that there aren't stand for the first one; their lanes hold anything.
    std::array<const double*, geometry::kDimsMax> x = particles_.position;
    for (std::size_t a = axes(); a < x.size(); ++a) x[a] = x[0];
    std::array<std::uint32_t, kBlock> which;
    std::array<std::uint8_t, kBlock> inside;
    inside.fill(1);  // those behind the last particle aren't looked at
    for (std::size_t begin = 0; begin < particles_.count; begin += kBlock) {
      const std::size_t count = std::min(kBlock, particles_.count - begin);
      std::fill(inside.begin() + static_cast<std::ptrdiff_t>(count), inside.end(), std::uint8_t{1});
      std::uint32_t other = 0;
      for (std::size_t i = 0; i < count; ++i) {
        which[i] = static_cast<std::uint32_t>(index(begin + i));
        other |= which[i] ^ which[0];
      }
      const std::array<const double*, geometry::kDimsMax> at{x[0] + begin, x[1] + begin, x[2] + begin};
      if (other == 0)
        same_bounds<kAvx2>(at, bounds_[which[0]], count, inside.data());
      else
        own_bounds<kAvx2>(at, bounds_.data(), which.data(), count, inside.data());
      for (std::size_t k = 0; k < kBlock; k += sizeof(std::uint64_t)) {
        std::uint64_t eight = 0;
        std::memcpy(&eight, &inside[k], sizeof eight);
        if (eight == kAllInside) continue;
        for (std::size_t i = k; i < k + sizeof eight; ++i)
          if (inside[i] == 0) look(begin + i);
      }
    }
  }

  using Axes = std::array<const double*, geometry::kDimsMax>;

  // inside[i]: 1 where particle i lies within the bounds, else 0.
  template <bool kAvx2>
  static void same_bounds(const Axes& x, const Bounds& box, std::size_t count, std::uint8_t* inside) {
#if defined(__x86_64__)
    if constexpr (kAvx2) return same_bounds_avx2(x, box, count, inside);
#endif
    for (std::size_t i = 0; i < count; ++i) inside[i] = holds(x, box, i);
  }
  template <bool kAvx2>
  static void own_bounds(const Axes& x, const Bounds* bounds, const std::uint32_t* which, std::size_t count,
                         std::uint8_t* inside) {
#if defined(__x86_64__)
    if constexpr (kAvx2) return own_bounds_avx2(x, bounds, which, count, inside);
#endif
    for (std::size_t i = 0; i < count; ++i) inside[i] = holds(x, bounds[which[i]], i);
  }
  static std::uint8_t holds(const Axes& x, const Bounds& box, std::size_t i) {
    bool in = true;
    for (std::size_t a = 0; a < x.size(); ++a) in &= (x[a][i] >= box.lo[a]) & (x[a][i] <= box.hi[a]);
    return static_cast<std::uint8_t>(in);
  }

#if defined(__x86_64__)
  // Four particles at a time, an axis after the other.
  [[gnu::target("avx2")]] static void same_bounds_avx2(const Axes& x, const Bounds& box, std::size_t count,
                                                       std::uint8_t* inside) {
    std::size_t i = 0;
    for (; i + kLanes <= count; i += kLanes) {
      __m256d in = _mm256_castsi256_pd(_mm256_set1_epi64x(-1));
      for (std::size_t a = 0; a < x.size(); ++a) {
        const __m256d value = _mm256_loadu_pd(x[a] + i);
        in = _mm256_and_pd(in, _mm256_cmp_pd(value, _mm256_set1_pd(box.lo[a]), _CMP_GE_OQ));
        in = _mm256_and_pd(in, _mm256_cmp_pd(value, _mm256_set1_pd(box.hi[a]), _CMP_LE_OQ));
      }
      const int mask = _mm256_movemask_pd(in);
      for (std::size_t k = 0; k < kLanes; ++k)
        inside[i + k] = static_cast<std::uint8_t>((static_cast<unsigned>(mask) >> k) & 1U);
    }
    for (; i < count; ++i) inside[i] = holds(x, box, i);
  }
  // One particle at a time, all axes together.
  [[gnu::target("avx2")]] static void own_bounds_avx2(const Axes& x, const Bounds* bounds, const std::uint32_t* which,
                                                      std::size_t count, std::uint8_t* inside) {
    for (std::size_t i = 0; i < count; ++i) {
      const __m256d value = _mm256_set_pd(0, x[2][i], x[1][i], x[0][i]);
      const Bounds& box = bounds[which[i]];
      const __m256d in = _mm256_and_pd(_mm256_cmp_pd(value, _mm256_load_pd(box.lo.data()), _CMP_GE_OQ),
                                       _mm256_cmp_pd(value, _mm256_load_pd(box.hi.data()), _CMP_LE_OQ));
      inside[i] = static_cast<std::uint8_t>(_mm256_movemask_pd(in) == 0xF);
    }
  }
#endif

  const particles::ParticleView& particles_;
  std::span<const std::int32_t> part_;
  std::span<const geometry::Box> inner_;
  std::int32_t first_;
  Buffer<std::uint64_t>& few_;
  std::vector<Bounds> bounds_;  // [own parts + 1]: of those who stay so far
};

}  // namespace

OwnSettled settle(const particles::ParticleView& particles, std::span<const std::int32_t> part,
                  std::span<const geometry::Box> inner, OwnParts own) {
  OwnSettled out;
  out.few.reserve(particles.count / 8);
  Pass pass(particles, part, inner, own, out.few);
  pass.seed();
  pass.run();
  for (std::size_t p = 0; p < inner.size(); ++p) out.boxes.push_back(pass.box(p));
  return out;
}

}  // namespace rcb::partition
