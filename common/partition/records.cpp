#include "common/partition/records.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>

#include "common/base/check.hpp"
#include "common/partition/four_points.hpp"

namespace rcb::partition {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

// A record as one vector: moved by one load and one store.
using Lanes = std::int32_t __attribute__((vector_size(sizeof(Record)), may_alias));

constexpr unsigned kImageBits = 30;

// What a pass finds of an axis: whether some coordinate is not its integer's, and the bits that any integer has.
struct Told {
  std::int64_t differ = 0;
  std::int32_t bits = std::int32_t{1} << 30U;

  void look(double value, double again, std::int32_t q) {
    differ |= std::bit_cast<std::int64_t>(again - value);  // no branch, so that several are done at once
    bits |= q;
  }
  // Differences of 0.0 or -0.0 are none.
  int zeros() const { return differ << 1U != 0 ? -1 : std::countr_zero(static_cast<std::uint32_t>(bits)); }
};

// What maps by value do with a coordinate, by axis: q = (x / 2 - base) * scale, and back. Axes that there aren't give
// 0.
struct Even {
  std::array<const double*, geometry::kDimsMax> x;
  alignas(32) std::array<double, 4> base{};
  alignas(32) std::array<double, 4> scale{};
  alignas(32) std::array<double, 4> step{};

  Even(const particles::ParticleView& particles, std::size_t first, const AxisMaps& maps, std::size_t axes) {
    x.fill(particles.position[0] + first);
    for (std::size_t a = 0; a < axes; ++a) {
      x[a] = particles.position[a] + first;
      base[a] = maps[a].half_base();
      scale[a] = maps[a].scale();
      step[a] = 1 / scale[a];  // exact: a power of two
    }
  }
};

#if defined(__x86_64__)
// Four records at a time, each with all axes in one vector; returns how many are made.
template <bool kTell>
[[gnu::target("avx2")]] std::size_t fill_fours(const Even& even, std::span<Record> out,
                                               std::array<Told, geometry::kDimsMax>& told) {
  const __m256d base = _mm256_load_pd(even.base.data());
  const __m256d scale = _mm256_load_pd(even.scale.data());
  const __m256d step = _mm256_load_pd(even.step.data());
  const __m256d half = _mm256_set1_pd(0.5);
  const __m256d two = _mm256_set1_pd(2);
  __m256d differ = _mm256_setzero_pd();
  __m128i bits = _mm_setzero_si128();
  std::size_t i = 0;
  for (; i + 4 <= out.size(); i += 4) {
    __m256d point[4];
    load_four_points(even.x, i, point);
    for (std::size_t k = 0; k < 4; ++k) {
      const __m128i q = _mm256_cvttpd_epi32(_mm256_mul_pd(_mm256_sub_pd(_mm256_mul_pd(point[k], half), base), scale));
      if constexpr (kTell) {
        const __m256d again = _mm256_mul_pd(two, _mm256_add_pd(base, _mm256_mul_pd(_mm256_cvtepi32_pd(q), step)));
        differ = _mm256_or_pd(differ, _mm256_sub_pd(again, point[k]));
        bits = _mm_or_si128(bits, q);
      }
      _mm_store_si128(reinterpret_cast<__m128i*>(&out[i + k]), _mm_insert_epi32(q, static_cast<int>(i + k), 3));
    }
  }
  alignas(32) std::array<std::int64_t, 4> all_differ;
  alignas(16) std::array<std::int32_t, 4> all_bits;
  _mm256_store_si256(reinterpret_cast<__m256i*>(all_differ.data()), _mm256_castpd_si256(differ));
  _mm_store_si128(reinterpret_cast<__m128i*>(all_bits.data()), bits);
  for (std::size_t a = 0; a < told.size(); ++a) {
    told[a].differ |= all_differ[a];
    told[a].bits |= all_bits[a];
  }
  return i;
}
#endif

// All maps by value: one loop over all axes, which is half the time of one loop an axis.
template <std::size_t kAxes, bool kTell>
void fill_even(const particles::ParticleView& particles, std::size_t first, const AxisMaps& maps, std::span<Record> out,
               std::array<Told, geometry::kDimsMax>& told) {
  const Even even(particles, first, maps, kAxes);
  std::size_t i = 0;
#if defined(__x86_64__)
  static const bool avx2 = __builtin_cpu_supports("avx2") != 0;
  if (avx2) i = fill_fours<kTell>(even, out, told);
#endif
  std::array<Told, kAxes> found;
  for (; i < out.size(); ++i) {
    Record record;
    for (std::size_t a = 0; a < kAxes; ++a) {
      const double x = even.x[a][i];
      const auto q = static_cast<std::int32_t>((x * 0.5 - even.base[a]) * even.scale[a]);
      if constexpr (kTell) found[a].look(x, 2 * (even.base[a] + q * even.step[a]), q);
      record.q[a] = q;
    }
    record.index = static_cast<std::uint32_t>(i);
    out[i] = record;
  }
  for (std::size_t a = 0; a < kAxes; ++a) {
    told[a].differ |= found[a].differ;
    told[a].bits |= found[a].bits;
  }
}

template <std::size_t kAxes>
void fill(const particles::ParticleView& particles, std::size_t first, const AxisMaps& maps, std::span<Record> out,
          bool tell, std::array<Told, geometry::kDimsMax>& told) {
  if (std::all_of(maps.begin(), maps.begin() + kAxes, [](const AxisMap& map) { return map.even(); })) {
    tell ? fill_even<kAxes, true>(particles, first, maps, out, told)
         : fill_even<kAxes, false>(particles, first, maps, out, told);
    return;
  }
  for (std::size_t i = 0; i < out.size(); ++i) {
    Record record;
    for (std::size_t a = 0; a < kAxes; ++a) record.q[a] = maps[a](particles.position[a][first + i]);
    record.index = static_cast<std::uint32_t>(i);
    out[i] = record;
  }
}

}  // namespace

AxisMap AxisMap::by_value(double lo, double hi) {
  AxisMap map = by_image(lo, hi);
  const double most = static_cast<double>(kTop) / (hi * 0.5 - lo * 0.5);
  if (!std::isnormal(most)) return map;
  map.half_base_ = lo * 0.5;
  map.scale_ = std::ldexp(1.0, std::ilogb(most));
  map.exact_ = false;
  return map;
}

AxisMap AxisMap::by_image(double lo, double hi) {
  AxisMap map;
  map.lo_ = geometry::image(lo);
  map.hi_ = geometry::image(hi);
  map.shift_ = shift_to(map.hi_ - map.lo_, kImageBits);
  map.exact_ = map.shift_ == 0;
  return map;
}

AxisMap AxisMap::of_ids(Id lo, Id hi) {
  AxisMap map;
  map.lo_ = static_cast<std::uint64_t>(lo);
  map.hi_ = static_cast<std::uint64_t>(hi);
  map.shift_ = shift_to(map.hi_ - map.lo_, kImageBits);
  return map;
}

// Rounding moves a coordinate by far less than one step before it is cut off to an integer.
double AxisMap::least(std::int32_t q) const {
  if (exact_) return value(q);
  if (even()) return std::nextafter(2 * (half_base_ + (q - 1) / scale_), -kInfinity);
  return geometry::value_of_image(lo_ + (static_cast<std::uint64_t>(q) << shift_));
}

double AxisMap::most(std::int32_t q) const {
  if (exact_) return value(q);
  if (even()) return std::nextafter(2 * (half_base_ + (q + 2.0) / scale_), kInfinity);
  return geometry::value_of_image(std::min(hi_, lo_ + ((static_cast<std::uint64_t>(q) + 1) << shift_) - 1));
}

double AxisMap::first_value(std::int32_t q) const {
  std::uint64_t low = lo_;
  std::uint64_t high = hi_;
  while (low < high) {
    const std::uint64_t middle = low + (high - low) / 2;
    if ((*this)(geometry::value_of_image(middle)) >= q)
      high = middle;
    else
      low = middle + 1;
  }
  return geometry::value_of_image(low);
}

int zeros_of_told(const AxisMap& map, std::span<const double> x) {
  Told told;
  for (const double value : x) told.look(value, map.value(map(value)), map(value));
  return told.zeros();
}

std::array<int, geometry::kDimsMax> Records::build(const particles::ParticleView& particles, int axes,
                                                   const AxisMaps& maps, std::size_t chunk_max, bool tell) {
  std::array<Told, geometry::kDimsMax> told;
  chunks_.clear();
  for (std::size_t first = 0; first < particles.count || first == 0; first += chunk_max) {
    Buffer<Record>& chunk = chunks_.emplace_back(std::min(chunk_max, particles.count - first));
    switch (axes) {
      case 0:
        for (std::size_t i = 0; i < chunk.size(); ++i)
          chunk[i] = {{maps[0](particles.id[first + i]), 0, 0}, static_cast<std::uint32_t>(i)};
        break;
      case 1:
        fill<1>(particles, first, maps, chunk.span(), tell, told);
        break;
      case 2:
        fill<2>(particles, first, maps, chunk.span(), tell, told);
        break;
      default:
        fill<3>(particles, first, maps, chunk.span(), tell, told);
        break;
    }
  }
  std::array<int, geometry::kDimsMax> zeros{-1, -1, -1};
  for (std::size_t a = 0; a < zeros.size() && tell; ++a) zeros[a] = told[a].zeros();
  return zeros;
}

std::vector<Span> Records::spans() {
  std::vector<Span> spans;
  std::uint64_t base = 0;
  for (Buffer<Record>& chunk : chunks_) {
    spans.push_back({chunk.begin(), chunk.begin(), chunk.end(), chunk.end(), nullptr, nullptr, base});
    base += chunk.size();
  }
  return spans;
}

Buffer<std::int32_t> Records::into_parts(std::span<const std::size_t> ends, int parts) {
  // In the records' own memory: a chunk's numbers move to its front, the parts are written behind them, and then take
  // their place.
  Buffer<std::int32_t> all;
  for (std::size_t c = 0; c < chunks_.size(); ++c) {
    const std::size_t size = chunks_[c].size();
    Buffer<std::int32_t> own = chunks_[c].release_as<std::int32_t>();
    constexpr std::size_t kWords = sizeof(Record) / sizeof(std::int32_t);
    for (std::size_t i = 0; i < size; ++i) own[i] = own[i * kWords + kWords - 1];
    std::int32_t* const part = own.data() + size;
    std::size_t i = 0;
    for (std::int32_t p = 0; p < parts; ++p)
      for (const std::size_t end = ends[c * static_cast<std::size_t>(parts) + static_cast<std::size_t>(p)]; i < end;
           ++i)
        part[static_cast<std::uint32_t>(own[i])] = p;
    CHECK(i == size, "every record is in a part");
    if (size > 0) std::memmove(own.data(), part, size * sizeof(std::int32_t));
    own.resize(size);
    own.shrink();
    if (c == 0)
      all = std::move(own);
    else
      all.append(own.span());
  }
  chunks_.clear();
  return all;
}

// Records that stand right already, at either end, are passed by: solvers' orders are seldom random. Of the others
// every one is moved, so that nothing depends on a branch that can't be foretold.
Record* split(std::span<Record> records, std::size_t axis, std::int32_t at) {
  while (!records.empty() && records.front().q[axis] < at) records = records.subspan(1);
  while (!records.empty() && records.back().q[axis] >= at) records = records.first(records.size() - 1);
  auto* const lanes = reinterpret_cast<Lanes*>(records.data());
  const Record* const from = records.data();
  std::size_t below = 0;
  for (std::size_t i = 0; i < records.size(); ++i) {
    const Lanes own = lanes[i];
    const bool left = from[i].q[axis] < at;
    lanes[i] = lanes[below];
    lanes[below] = own;
    below += static_cast<std::size_t>(left);
  }
  return records.data() + below;
}

Record* split_few(std::span<Record> records, std::size_t axis, std::int32_t at) {
  constexpr std::size_t kStride = 8;  // most of these have none
  Record* next = records.data();
  std::size_t i = 0;
  for (; i + kStride <= records.size(); i += kStride) {
    std::int32_t any = 0;
    for (std::size_t k = 0; k < kStride; ++k) any |= records[i + k].q[axis] <= at ? 1 : 0;
    if (any == 0) continue;
    for (std::size_t k = 0; k < kStride; ++k)
      if (records[i + k].q[axis] <= at) std::swap(records[i + k], *next++);
  }
  for (; i < records.size(); ++i)
    if (records[i].q[axis] <= at) std::swap(records[i], *next++);
  return next;
}

void count_bins(std::span<const Record> records, std::size_t axis, std::int32_t lo, unsigned shift,
                std::span<std::uint32_t> bins) {
  // Two tables: neighbours often share a bin, and would wait for each other.
  static thread_local Buffer<std::uint32_t> spare;
  spare.resize(bins.size());
  std::fill(spare.begin(), spare.end(), 0);
  std::uint32_t* const even = bins.data();
  std::uint32_t* const odd = spare.data();
  const auto bin = [&](std::size_t i) { return static_cast<std::uint32_t>(records[i].q[axis] - lo) >> shift; };
  std::size_t i = 0;
  for (; i + 2 <= records.size(); i += 2) {
    ++even[bin(i)];
    ++odd[bin(i + 1)];
  }
  if (i < records.size()) ++even[bin(i)];
  for (std::size_t b = 0; b < bins.size(); ++b) even[b] += odd[b];
}

// Written once, compiled twice: with the instruction for the lesser of two integers, where the machine has it, a pass
// takes half the time. The thread sanitizer starts too late for the choice, which is made while the program is loaded.
#if defined(__x86_64__) && !defined(__SANITIZE_THREAD__)
__attribute__((target_clones("avx2", "default")))
#endif
void widen(QBounds& bounds, std::span<const Record> records) {
  const auto* const lanes = reinterpret_cast<const Lanes*>(records.data());
  Lanes lo{bounds.lo[0], bounds.lo[1], bounds.lo[2], 0};
  Lanes hi{bounds.hi[0], bounds.hi[1], bounds.hi[2], 0};
  Lanes other_lo = lo;
  Lanes other_hi = hi;
  std::size_t i = 0;
  for (; i + 2 <= records.size(); i += 2) {
    lo = lanes[i] < lo ? lanes[i] : lo;
    hi = lanes[i] > hi ? lanes[i] : hi;
    other_lo = lanes[i + 1] < other_lo ? lanes[i + 1] : other_lo;
    other_hi = lanes[i + 1] > other_hi ? lanes[i + 1] : other_hi;
  }
  if (i < records.size()) {
    lo = lanes[i] < lo ? lanes[i] : lo;
    hi = lanes[i] > hi ? lanes[i] : hi;
  }
  for (int a = 0; a < geometry::kDimsMax; ++a) {
    bounds.lo[static_cast<std::size_t>(a)] = std::min(lo[a], other_lo[a]);
    bounds.hi[static_cast<std::size_t>(a)] = std::max(hi[a], other_hi[a]);
  }
}

}  // namespace rcb::partition
