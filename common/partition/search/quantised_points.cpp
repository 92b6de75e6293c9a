#include "common/partition/search/quantised_points.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <numeric>

#include "common/base/count_groups.hpp"
#include "common/base/cpu.hpp"
#include "common/partition/search/buckets.hpp"
#include "common/partition/search/four_points.hpp"

namespace rcb::partition {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

// A quantised point as one vector: moved by one load and one store.
using Lanes = std::int32_t __attribute__((vector_size(sizeof(QuantisedPoint)), may_alias));

constexpr unsigned kOrderBits = 30;

// What a pass learns of an axis: whether quantising changed any coordinate, and the bits set in any integer.
struct Lossless {
  std::int64_t differ = 0;
  std::int32_t bits = std::int32_t{1} << 30U;

  void look(double value, double again, std::int32_t q) {
    differ |= std::bit_cast<std::int64_t>(again - value);  // no branch, so that the loop can be vectorised
    bits |= q;
  }
  // The shift drops the sign: -0.0 is no difference either.
  int zeros() const { return differ << 1U != 0 ? -1 : std::countr_zero(static_cast<std::uint32_t>(bits)); }
};

// The constants of maps by value, per axis: q = (x / 2 - base) * scale, and back. Axes >= dims give 0.
struct ByValue {
  particles::Axes x;
  alignas(32) std::array<double, 4> base{};
  alignas(32) std::array<double, 4> scale{};
  alignas(32) std::array<double, 4> step{};

  ByValue(const particles::ParticleView& particles, std::size_t first, const AxisMaps& maps, std::size_t axes)
      : x(particles.all_axes(first)) {
    for (std::size_t a = 0; a < axes; ++a) {
      base[a] = maps[a].half_base();
      scale[a] = maps[a].scale();
      step[a] = 1 / scale[a];  // exact: a power of two
    }
  }
};

// Where quantised points go if not in order: each behind the last one of its group, a root or a bucket.
template <typename Group>
struct ByGroup {
  Group group;  // of each particle; 0: none
  // Two of each group: particles of even number fill it from the front, odd ones from the back, so that a particle need
  // not wait for the one before it. Those of no group all go to one place behind the last group.
  std::vector<QuantisedPoint*> cursor;
  static constexpr std::intptr_t kAhead = 8 * sizeof(QuantisedPoint);
  QuantisedPoint* operator()(std::size_t i) {
    const std::size_t own = group(i);
    const bool odd = i % 2 != 0;
    const auto step = static_cast<std::ptrdiff_t>(own != 0);
    QuantisedPoint*& at = cursor[2 * own + (odd ? 1 : 0)];
    if (odd) at -= step;
    QuantisedPoint* const point = at;
    if (!odd) at += step;
    // The processor sees no pattern in so many places. The address may lie beyond the points: it isn't read.
    const auto ahead = reinterpret_cast<std::intptr_t>(point) + (odd ? -kAhead : kAhead);
    __builtin_prefetch(reinterpret_cast<const void*>(ahead), 1);
    return point;
  }
};

#if defined(__x86_64__)
// Makes quantised points four at a time, each with all axes in one vector; returns how many.
template <bool kCheckLossless, typename Places>
[[gnu::target("avx2")]] std::size_t fill_fours(const ByValue& linear, std::size_t count, Places& places,
                                               std::array<Lossless, geometry::kDimsMax>& lossless) {
  const __m256d base = _mm256_load_pd(linear.base.data());
  const __m256d scale = _mm256_load_pd(linear.scale.data());
  const __m256d step = _mm256_load_pd(linear.step.data());
  const __m256d half = _mm256_set1_pd(0.5);
  const __m256d two = _mm256_set1_pd(2);
  __m256d differ = _mm256_setzero_pd();
  __m128i bits = _mm_setzero_si128();
  std::size_t i = 0;
  for (; i + 4 <= count; i += 4) {
    __m256d point[4];
    load_four_points(linear.x, i, point);
    for (std::size_t k = 0; k < 4; ++k) {
      const __m128i q = _mm256_cvttpd_epi32(_mm256_mul_pd(_mm256_sub_pd(_mm256_mul_pd(point[k], half), base), scale));
      if constexpr (kCheckLossless) {
        const __m256d again = _mm256_mul_pd(two, _mm256_add_pd(base, _mm256_mul_pd(_mm256_cvtepi32_pd(q), step)));
        differ = _mm256_or_pd(differ, _mm256_sub_pd(again, point[k]));
        bits = _mm_or_si128(bits, q);
      }
      _mm_store_si128(reinterpret_cast<__m128i*>(places(i + k)), _mm_insert_epi32(q, static_cast<int>(i + k), 3));
    }
  }
  alignas(32) std::array<std::int64_t, 4> all_differ;
  alignas(16) std::array<std::int32_t, 4> all_bits;
  _mm256_store_si256(reinterpret_cast<__m256i*>(all_differ.data()), _mm256_castpd_si256(differ));
  _mm_store_si128(reinterpret_cast<__m128i*>(all_bits.data()), bits);
  for (std::size_t a = 0; a < lossless.size(); ++a) {
    lossless[a].differ |= all_differ[a];
    lossless[a].bits |= all_bits[a];
  }
  return i;
}
#endif

// All maps are by value: one loop over all axes takes half the time of one loop per axis.
template <std::size_t kAxes, bool kCheckLossless, typename Places>
void fill_by_value(const particles::ParticleView& particles, std::size_t first, std::size_t count, const AxisMaps& maps,
                   Places& places, std::array<Lossless, geometry::kDimsMax>& lossless) {
  const ByValue linear(particles, first, maps, kAxes);
  std::size_t i = 0;
#if defined(__x86_64__)
  if (has_avx2()) i = fill_fours<kCheckLossless>(linear, count, places, lossless);
#endif
  std::array<Lossless, kAxes> found;
  for (; i < count; ++i) {
    QuantisedPoint point;
    for (std::size_t a = 0; a < kAxes; ++a) {
      const double x = linear.x[a][i];
      const auto q = static_cast<std::int32_t>((x * 0.5 - linear.base[a]) * linear.scale[a]);
      if constexpr (kCheckLossless) found[a].look(x, 2 * (linear.base[a] + q * linear.step[a]), q);
      point.q[a] = q;
    }
    point.index = static_cast<std::uint32_t>(i);
    *places(i) = point;
  }
  for (std::size_t a = 0; a < kAxes; ++a) {
    lossless[a].differ |= found[a].differ;
    lossless[a].bits |= found[a].bits;
  }
}

template <std::size_t kAxes, typename Places>
void fill(const particles::ParticleView& particles, std::size_t first, std::size_t count, const AxisMaps& maps,
          Places& places, bool check_lossless, std::array<Lossless, geometry::kDimsMax>& lossless) {
  if (std::all_of(maps.begin(), maps.begin() + kAxes, [](const AxisMap& map) { return map.linear(); })) {
    check_lossless ? fill_by_value<kAxes, true>(particles, first, count, maps, places, lossless)
                   : fill_by_value<kAxes, false>(particles, first, count, maps, places, lossless);
    return;
  }
  for (std::size_t i = 0; i < count; ++i) {
    QuantisedPoint point;
    for (std::size_t a = 0; a < kAxes; ++a) point.q[a] = maps[a](particles.position[a][first + i]);
    point.index = static_cast<std::uint32_t>(i);
    *places(i) = point;
  }
}

template <typename Places>
void fill(const particles::ParticleView& particles, std::size_t first, std::size_t count, const AxisMaps& maps,
          Places places, bool check_lossless, std::array<Lossless, geometry::kDimsMax>& lossless) {
  switch (particles.dims) {
    case 1:
      return fill<1>(particles, first, count, maps, places, check_lossless, lossless);
    case 2:
      return fill<2>(particles, first, count, maps, places, check_lossless, lossless);
    default:
      return fill<3>(particles, first, count, maps, places, check_lossless, lossless);
  }
}

}  // namespace

AxisMap AxisMap::by_value(double lo, double hi) {
  AxisMap map = by_order_bits(lo, hi);
  const double most = static_cast<double>(kTop) / (hi * 0.5 - lo * 0.5);
  if (!std::isnormal(most)) return map;
  map.half_base_ = lo * 0.5;
  map.scale_ = std::ldexp(1.0, std::ilogb(most));
  map.lossless_ = false;
  return map;
}

AxisMap AxisMap::by_order_bits(double lo, double hi) {
  AxisMap map;
  map.lo_ = geometry::order_bits(lo);
  map.hi_ = geometry::order_bits(hi);
  map.shift_ = shift_to(map.hi_ - map.lo_, kOrderBits);
  map.lossless_ = map.shift_ == 0;
  return map;
}

// Rounding moves a coordinate by far less than one step before it is truncated to an integer: a margin of one step is
// enough.
double AxisMap::least(std::int32_t q) const {
  if (lossless_ || !linear()) return value(q);
  return std::nextafter(2 * (half_base_ + (q - 1) / scale_), -kInfinity);
}

double AxisMap::most(std::int32_t q) const {
  if (lossless_) return value(q);
  if (linear()) return std::nextafter(2 * (half_base_ + (q + 2.0) / scale_), kInfinity);
  return geometry::value_of_order_bits(std::min(hi_, lo_ + ((static_cast<std::uint64_t>(q) + 1) << shift_) - 1));
}

double AxisMap::first_value(std::int32_t q) const {
  std::uint64_t low = lo_;
  std::uint64_t high = hi_;
  while (low < high) {
    const std::uint64_t middle = low + (high - low) / 2;
    if ((*this)(geometry::value_of_order_bits(middle)) >= q)
      high = middle;
    else
      low = middle + 1;
  }
  return geometry::value_of_order_bits(low);
}

int zeros_of_lossless(const AxisMap& map, std::span<const double> x) {
  Lossless lossless;
  for (const double value : x) lossless.look(value, map.value(map(value)), map(value));
  return lossless.zeros();
}

std::array<int, geometry::kDimsMax> QuantisedPoints::build(const particles::ParticleView& particles,
                                                           const AxisMaps& maps, std::size_t chunk_max,
                                                           bool check_lossless, const Roots& roots,
                                                           std::span<const std::uint8_t> bucket) {
  std::array<Lossless, geometry::kDimsMax> lossless;
  chunks_.clear();
  for (std::size_t first = 0; first < particles.count || first == 0; first += chunk_max) {
    const std::size_t count = std::min(chunk_max, particles.count - first);
    Chunk& chunk = chunks_.emplace_back();
    chunk.base = first;
    const auto fill_groups = [&](const auto& group, std::size_t groups) {
      const std::vector<std::uint64_t> counts = count_groups(group, groups + 1, count);
      std::partial_sum(counts.begin() + 1, counts.end(), std::back_inserter(chunk.ends));
      chunk.points.resize(chunk.ends.back() + 1);
      QuantisedPoint* const points = chunk.points.data();
      std::vector<QuantisedPoint*> cursor{points + chunk.ends.back(), points + chunk.ends.back()};
      for (std::size_t g = 0; g < groups; ++g)
        cursor.insert(cursor.end(), {points + (g == 0 ? 0 : chunk.ends[g - 1]), points + chunk.ends[g]});
      fill(particles, first, count, maps, ByGroup{group, std::move(cursor)}, check_lossless, lossless);
    };
    if (!bucket.empty()) {
      fill_groups([own = bucket.data() + first](std::size_t i) { return std::size_t{own[i]} + 1; }, kBuckets);
    } else if (!roots.one()) {
      const auto root = [part = roots.part.data() + first, root_of = roots.root_of.data()](std::size_t i) {
        return static_cast<std::size_t>(root_of[part[i]] + 1);
      };
      fill_groups(root, roots.count);
    } else {
      chunk.ends = {count};
      chunk.points.resize(count);
      const auto in_order = [out = chunk.points.data()](std::size_t i) { return out + i; };
      fill(particles, first, count, maps, in_order, check_lossless, lossless);
    }
  }
  std::array<int, geometry::kDimsMax> zeros{-1, -1, -1};
  for (std::size_t a = 0; a < zeros.size() && check_lossless; ++a) zeros[a] = lossless[a].zeros();
  return zeros;
}

std::size_t QuantisedPoints::size() const {
  std::size_t size = 0;
  for (const Chunk& chunk : chunks_) size += chunk.ends.back();
  return size;
}

std::vector<Span> QuantisedPoints::spans() {
  std::vector<Span> spans;
  for (std::size_t r = 0; r < chunks_[0].ends.size(); ++r)
    for (Chunk& chunk : chunks_) {
      QuantisedPoint* const first = chunk.points.data() + (r == 0 ? 0 : chunk.ends[r - 1]);
      QuantisedPoint* const last = chunk.points.data() + chunk.ends[r];
      spans.push_back({.first = first, .last = last, .base = chunk.base});
    }
  return spans;
}

// Points at either end that are on the right side already are skipped, since solvers' orders are seldom random. All
// others are swapped without a branch, which would often be mispredicted. Four at a time: the time of a shorter loop
// depends on where the linker puts it (by up to 40 % on Zen 5).
QuantisedPoint* split(std::span<QuantisedPoint> points, std::size_t axis, std::int32_t at) {
  while (!points.empty() && points.front().q[axis] < at) points = points.subspan(1);
  while (!points.empty() && points.back().q[axis] >= at) points = points.first(points.size() - 1);
  QuantisedPoint* left_end = points.data();
  const auto swap = [&](QuantisedPoint& point) {
    Lanes& own = reinterpret_cast<Lanes&>(point);
    Lanes& other = reinterpret_cast<Lanes&>(*left_end);
    const Lanes moved = own;
    left_end += static_cast<std::ptrdiff_t>(point.q[axis] < at);
    own = other;
    other = moved;
  };
  std::size_t i = 0;
  for (; i + 4 <= points.size(); i += 4)
    for (std::size_t k = 0; k < 4; ++k) swap(points[i + k]);
  for (; i < points.size(); ++i) swap(points[i]);
  return left_end;
}

namespace {

// Calls move() with every point that is `wanted`, those of a block at a time, which are listed first: few points are
// wanted, and a branch on each would often be mispredicted.
template <typename Iterator, typename Wanted, typename Move>
void for_each_of(Iterator points, std::size_t size, const Wanted& wanted, const Move& move) {
  constexpr std::size_t kRowsTogether = 512;
  std::array<std::uint32_t, kRowsTogether> found;
  for (std::size_t begin = 0; begin < size; begin += kRowsTogether) {
    const auto block = points + static_cast<std::ptrdiff_t>(begin);
    const auto most = static_cast<std::uint32_t>(std::min(kRowsTogether, size - begin));
    std::size_t count = 0;
    for (std::uint32_t k = 0; k < most; ++k) {
      found[count] = k;
      count += wanted(block[k]) ? 1U : 0U;
    }
    for (std::size_t k = 0; k < count; ++k) move(block[found[k]]);
  }
}

}  // namespace

QuantisedPoint* split_few(std::span<QuantisedPoint> points, std::size_t axis, std::int32_t at) {
  QuantisedPoint* next = points.data();
  for_each_of(
      points.begin(), points.size(), [=](const QuantisedPoint& point) { return point.q[axis] < at; },
      [&](QuantisedPoint& point) { std::swap(point, *next++); });
  return next;
}

QuantisedPoint* split_few_back(std::span<QuantisedPoint> points, std::size_t axis, std::int32_t at) {
  QuantisedPoint* end = points.data() + points.size();
  for_each_of(
      points.rbegin(), points.size(), [=](const QuantisedPoint& point) { return point.q[axis] >= at; },
      [&](QuantisedPoint& point) { std::swap(point, *--end); });
  return end;
}

void count_bins(std::span<const QuantisedPoint> points, std::size_t axis, std::int32_t lo, unsigned shift,
                std::span<std::uint32_t> even, std::span<std::uint32_t> odd) {
  const auto bin = [&](std::size_t i) { return static_cast<std::uint32_t>(points[i].q[axis] - lo) >> shift; };
  std::size_t i = 0;
  for (; i + 2 <= points.size(); i += 2) {
    ++even[bin(i)];
    ++odd[bin(i + 1)];
  }
  if (i < points.size()) ++even[bin(i)];
}

// Compiled twice: with AVX2's vector minimum a pass takes half the time. The version is chosen while the program is
// loaded, which is before the thread sanitizer has started, hence not with it.
#if defined(__x86_64__) && !defined(__SANITIZE_THREAD__)
__attribute__((target_clones("avx2", "default")))
#endif
void widen(QBounds& bounds, std::span<const QuantisedPoint> points) {
  const auto* const lanes = reinterpret_cast<const Lanes*>(points.data());
  Lanes lo{bounds.lo[0], bounds.lo[1], bounds.lo[2], 0};
  Lanes hi{bounds.hi[0], bounds.hi[1], bounds.hi[2], 0};
  Lanes other_lo = lo;
  Lanes other_hi = hi;
  std::size_t i = 0;
  for (; i + 2 <= points.size(); i += 2) {
    lo = lanes[i] < lo ? lanes[i] : lo;
    hi = lanes[i] > hi ? lanes[i] : hi;
    other_lo = lanes[i + 1] < other_lo ? lanes[i + 1] : other_lo;
    other_hi = lanes[i + 1] > other_hi ? lanes[i + 1] : other_hi;
  }
  if (i < points.size()) {
    lo = lanes[i] < lo ? lanes[i] : lo;
    hi = lanes[i] > hi ? lanes[i] : hi;
  }
  for (int a = 0; a < geometry::kDimsMax; ++a) {
    bounds.lo[static_cast<std::size_t>(a)] = std::min(lo[a], other_lo[a]);
    bounds.hi[static_cast<std::size_t>(a)] = std::max(hi[a], other_hi[a]);
  }
}

}  // namespace rcb::partition
