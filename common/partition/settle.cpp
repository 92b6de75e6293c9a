// A part's box grows with the particles that stay. Almost all lie within what it is already, and that one comparison
// says that they stay, since the box lies in the inner region; only the others are looked at one by one.
#include "common/partition/settle.hpp"

#include <algorithm>
#include <array>
#include <cstring>

namespace rcb::partition {
namespace {

constexpr std::size_t kBlock = 64;
constexpr std::uint64_t kAllInside = 0x0101010101010101U;

// One cache line.
struct alignas(64) Bounds {
  std::array<double, geometry::kDimsMax> lo;
  std::array<double, geometry::kDimsMax> hi;
};

struct Pass {
  const particles::ParticleView& particles;
  std::span<const std::int32_t> part;
  std::span<const geometry::Box> inner;
  OwnParts own;
  std::vector<Bounds> bounds;  // [own parts + 1]: of those who stay so far; the last: of other ranks' parts
  OwnSettled& out;

  std::size_t index(std::int32_t p) const {
    return p >= own.first && p < own.last ? static_cast<std::size_t>(p - own.first) : inner.size();
  }

  // One that the bounds so far don't hold.
  void look(std::size_t i) {
    const std::size_t p = index(part[i]);
    bool inside = p < inner.size();
    for (std::size_t a = 0; a < static_cast<std::size_t>(particles.dims) && inside; ++a)
      inside = particles.position[a][i] > inner[p].lo[a] && particles.position[a][i] < inner[p].hi[a];
    if (!inside) {
      out.few.push_back(i);
      return;
    }
    for (std::size_t a = 0; a < static_cast<std::size_t>(particles.dims); ++a) {
      bounds[p].lo[a] = std::min(bounds[p].lo[a], particles.position[a][i]);
      bounds[p].hi[a] = std::max(bounds[p].hi[a], particles.position[a][i]);
    }
    ++out.counts[p];
  }
};

// Which of a block's particles lie within their part's bounds: a byte each, 1 or 0. Branch-free.
template <std::size_t kDims>
[[gnu::always_inline]] inline void within(const Pass& pass, std::size_t begin, std::size_t count, bool same,
                                          std::uint8_t* inside) {
  const std::array<const double*, geometry::kDimsMax>& x = pass.particles.position;
  if (same) {
    const Bounds box = pass.bounds[pass.index(pass.part[begin])];
    std::array<std::int64_t, kBlock> wide;
    for (std::size_t i = 0; i < count; ++i) {
      std::int64_t in = 1;
      for (std::size_t a = 0; a < kDims; ++a)
        in &= static_cast<std::int64_t>(x[a][begin + i] >= box.lo[a]) &
              static_cast<std::int64_t>(x[a][begin + i] <= box.hi[a]);
      wide[i] = in;
    }
    for (std::size_t i = 0; i < count; ++i) inside[i] = static_cast<std::uint8_t>(wide[i]);
    return;
  }
  for (std::size_t i = 0; i < count; ++i) {
    const Bounds& box = pass.bounds[pass.index(pass.part[begin + i])];
    bool in = true;
    for (std::size_t a = 0; a < kDims; ++a) in &= (x[a][begin + i] >= box.lo[a]) & (x[a][begin + i] <= box.hi[a]);
    inside[i] = static_cast<std::uint8_t>(in);
  }
}

template <std::size_t kDims>
[[gnu::always_inline]] inline void run(Pass& pass) {
  const std::size_t all = pass.particles.count;
  for (std::size_t begin = 0; begin < all; begin += kBlock) {
    const std::size_t count = std::min(kBlock, all - begin);
    std::int32_t other = 0;
    for (std::size_t i = 0; i < count; ++i) other |= pass.part[begin + i] ^ pass.part[begin];
    std::array<std::uint8_t, kBlock> inside;
    inside.fill(1);  // those behind the last particle aren't looked at
    within<kDims>(pass, begin, count, other == 0, inside.data());
    std::size_t looked = 0;
    for (std::size_t k = 0; k < kBlock; k += sizeof(std::uint64_t)) {
      std::uint64_t eight = 0;
      std::memcpy(&eight, &inside[k], sizeof eight);
      if (eight == kAllInside) continue;
      for (std::size_t i = k; i < k + sizeof eight; ++i)
        if (inside[i] == 0) pass.look(begin + i), ++looked;
    }
    if (other == 0) {
      const std::size_t p = pass.index(pass.part[begin]);
      if (p < pass.inner.size()) pass.out.counts[p] += count - looked;
    } else {
      for (std::size_t i = 0; i < count; ++i)
        if (inside[i] != 0) ++pass.out.counts[pass.index(pass.part[begin + i])];
    }
  }
}

#if defined(__x86_64__) && !defined(__SANITIZE_THREAD__)
__attribute__((target_clones("avx2", "default")))
#endif
void run_any(Pass& pass) {
  if (pass.particles.dims == 1)
    run<1>(pass);
  else if (pass.particles.dims == 2)
    run<2>(pass);
  else
    run<3>(pass);
}

}  // namespace

OwnSettled settle(const particles::ParticleView& particles, std::span<const std::int32_t> part,
                  std::span<const geometry::Box> inner, OwnParts own) {
  OwnSettled out;
  out.counts.assign(inner.size(), 0);
  const geometry::Box none;
  Pass pass{particles, part, inner, own, std::vector<Bounds>(inner.size() + 1, Bounds{none.lo, none.hi}), out};
  // Some thousand from everywhere first: then orders in which each particle lies beyond the ones before it cost no more
  // than others. They are counted later.
  const std::size_t stride = std::max<std::size_t>(particles.count / 4096, 1);
  for (std::size_t i = 0; i < particles.count; i += stride) pass.look(i);
  out.few.clear();
  std::fill(out.counts.begin(), out.counts.end(), 0);
  run_any(pass);
  for (std::size_t p = 0; p < inner.size(); ++p) out.boxes.push_back({pass.bounds[p].lo, pass.bounds[p].hi});
  return out;
}

}  // namespace rcb::partition
