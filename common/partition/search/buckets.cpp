#include "common/partition/search/buckets.hpp"

#include <algorithm>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "common/base/cpu.hpp"
#include "common/base/index.hpp"

namespace rcb::partition {
namespace {

using particles::Axes;

// The particles from `i` on.
void sort_one_by_one(const Axes& x, std::size_t i, std::size_t count, const Splitters& splitters, std::uint8_t* bucket,
                     geometry::Box& box) {
  for (; i < count; ++i) {
    box.extend({x[0][i], x[1][i], x[2][i]}, geometry::kDimsMax);
    std::size_t node = 0;
    while (node < Splitters::kNodes) {
      const auto& [least, most, axis] = splitters.nodes[node];
      const float on = splitters.rounded(at(axis), x[at(axis)][i]);
      if (on >= least && on <= most) break;
      node = 2 * node + (on > most ? 2 : 1);
    }
    bucket[i] = static_cast<std::uint8_t>(node);
  }
}

#if defined(__x86_64__)
// A level's nodes as vectors. Place p belongs to the node whose number is p modulo their number, so that the low bits
// of a node's number find it in a table of any length.
struct alignas(64) LevelTable {
  static constexpr std::size_t kPlaces = std::size_t{1} << (Splitters::kLevels - 1);
  std::array<float, kPlaces> least;
  std::array<float, kPlaces> most;
  std::array<std::uint32_t, geometry::kDimsMax> on{};  // by axis: bit p: it is that of place p
};
using LevelTables = std::array<LevelTable, Splitters::kLevels>;

LevelTables tables_of(const Splitters& splitters) {
  LevelTables tables;
  for (std::size_t level = 0; level < tables.size(); ++level)
    for (std::size_t place = 0; place < LevelTable::kPlaces; ++place) {
      const std::size_t count = std::size_t{1} << level;
      const Splitters::Node& node = splitters.nodes[count - 1 + (place + 1) % count];
      tables[level].least[place] = node.least;
      tables[level].most[place] = node.most;
      tables[level].on[at(node.axis)] |= std::uint32_t{1} << place;
    }
  return tables;
}

[[gnu::target(RCB_AVX2), gnu::always_inline]] inline __m256 in_eight(const float* table, __m256i node) {
  return _mm256_permutevar8x32_ps(_mm256_load_ps(table), node);
}
// By the low four bits of the number.
[[gnu::target(RCB_AVX2), gnu::always_inline]] inline __m256 in_sixteen(const float* table, __m256i node) {
  const __m256 bit3 = _mm256_castsi256_ps(_mm256_slli_epi32(node, 28));
  return _mm256_blendv_ps(in_eight(table, node), in_eight(table + 8, node), bit3);
}
template <std::size_t kLevel>
[[gnu::target(RCB_AVX2), gnu::always_inline]] inline __m256 in_table8(const float* table, __m256i node) {
  if constexpr (kLevel <= 3) return in_eight(table, node);
  if constexpr (kLevel <= 4) return in_sixteen(table, node);
  const __m256 bit4 = _mm256_castsi256_ps(_mm256_slli_epi32(node, 27));
  return _mm256_blendv_ps(in_sixteen(table, node), in_sixteen(table + 16, node), bit4);
}
// Where bit (31 - up) of `bits` is set, as blendv asks for it.
[[gnu::target(RCB_AVX2), gnu::always_inline]] inline __m256 is_set8(std::uint32_t bits, __m256i up) {
  return _mm256_castsi256_ps(_mm256_sllv_epi32(_mm256_set1_epi32(static_cast<int>(bits)), up));
}

template <std::size_t kAxes, std::size_t kLevel = 0>
[[gnu::target(RCB_AVX2), gnu::always_inline]] inline void step8(const LevelTables& tables, const __m256 own[kAxes],
                                                                __m256i& node, __m256i& found) {
  if constexpr (kLevel < Splitters::kLevels) {
    const LevelTable& table = tables[kLevel];
    const __m256i place = _mm256_and_si256(node, _mm256_set1_epi32(LevelTable::kPlaces - 1));
    const __m256i up = _mm256_sub_epi32(_mm256_set1_epi32(LevelTable::kPlaces - 1), place);
    __m256 on = _mm256_blendv_ps(own[0], own[1], is_set8(table.on[1], up));
    if constexpr (kAxes > 2) on = _mm256_blendv_ps(on, own[2], is_set8(table.on[2], up));
    const __m256 before = _mm256_cmp_ps(on, in_table8<kLevel>(table.least.data(), node), _CMP_LT_OQ);
    const __m256 right = _mm256_cmp_ps(on, in_table8<kLevel>(table.most.data(), node), _CMP_GT_OQ);
    const __m256i outside = _mm256_castps_si256(_mm256_or_ps(before, right));
    found = _mm256_min_epu32(found, _mm256_or_si256(node, outside));
    node = _mm256_sub_epi32(_mm256_add_epi32(_mm256_add_epi32(node, node), _mm256_set1_epi32(1)),
                            _mm256_castps_si256(right));
    step8<kAxes, kLevel + 1>(tables, own, node, found);
  }
}

// Eight at a time, on kAxes axes: 2 where there are no more, else 3. Returns how many particles it took.
template <std::size_t kAxes>
[[gnu::target(RCB_AVX2)]] std::size_t sort_in_avx2(const Axes& x, std::size_t count, const Splitters& splitters,
                                                   std::uint8_t* bucket, geometry::Box& box) {
  const LevelTables tables = tables_of(splitters);
  const RoundedAxes rounded = splitters.rounded;  // a copy, since the buckets' bytes may alias everything else
  __m256d lo[kAxes];
  __m256d hi[kAxes];
  for (std::size_t a = 0; a < kAxes; ++a) {
    lo[a] = _mm256_set1_pd(box.lo[a]);
    hi[a] = _mm256_set1_pd(box.hi[a]);
  }
  std::size_t i = 0;
  for (; i + 8 <= count; i += 8) {
    __m256 own[kAxes];
    for (std::size_t a = 0; a < kAxes; ++a) {
      const __m256d low = _mm256_loadu_pd(x[a] + i);
      const __m256d high = _mm256_loadu_pd(x[a] + i + 4);
      lo[a] = _mm256_min_pd(lo[a], _mm256_min_pd(low, high));
      hi[a] = _mm256_max_pd(hi[a], _mm256_max_pd(low, high));
      own[a] = rounded8(rounded, a, x[a] + i);
    }
    __m256i node = _mm256_setzero_si256();
    __m256i found = _mm256_set1_epi32(-1);
    step8<kAxes>(tables, own, node, found);
    alignas(32) std::array<std::int32_t, 8> all;
    _mm256_store_si256(reinterpret_cast<__m256i*>(all.data()), _mm256_min_epu32(found, node));
    for (std::size_t k = 0; k < all.size(); ++k) bucket[i + k] = static_cast<std::uint8_t>(all[k]);
  }
  for (std::size_t a = 0; a < kAxes; ++a)
    for (int lane = 0; lane < 4; ++lane) {
      box.lo[a] = std::min(box.lo[a], lo[a][lane]);
      box.hi[a] = std::max(box.hi[a], hi[a][lane]);
    }
  return i;
}

template <std::size_t kLevel>
[[gnu::target(RCB_AVX512), gnu::always_inline]] inline __m512 in_table16(const float* table, __m512i node) {
  const __m512 low = _mm512_load_ps(table);
  if constexpr (kLevel <= 4) return _mm512_permutexvar_ps(node, low);
  return _mm512_permutex2var_ps(low, node, _mm512_load_ps(table + 16));
}

template <std::size_t kAxes, std::size_t kLevel = 0>
[[gnu::target(RCB_AVX512), gnu::always_inline]] inline void step16(const LevelTables& tables, const __m512 own[kAxes],
                                                                   __m512i& node, __m512i& found) {
  if constexpr (kLevel < Splitters::kLevels) {
    const LevelTable& table = tables[kLevel];
    const __m512i bit = _mm512_rolv_epi32(_mm512_set1_epi32(1), node);
    const __mmask16 on_y = _mm512_test_epi32_mask(bit, _mm512_set1_epi32(static_cast<int>(table.on[1])));
    __m512 on = _mm512_mask_blend_ps(on_y, own[0], own[1]);
    if constexpr (kAxes > 2) {
      const __mmask16 on_z = _mm512_test_epi32_mask(bit, _mm512_set1_epi32(static_cast<int>(table.on[2])));
      on = _mm512_mask_blend_ps(on_z, on, own[2]);
    }
    const __mmask16 reaches = _mm512_cmp_ps_mask(on, in_table16<kLevel>(table.least.data(), node), _CMP_GE_OQ);
    const __m512 most = in_table16<kLevel>(table.most.data(), node);
    const __mmask16 right = _mm512_cmp_ps_mask(on, most, _CMP_GT_OQ);
    const __mmask16 within = _mm512_mask_cmp_ps_mask(reaches, on, most, _CMP_LE_OQ);
    found = _mm512_mask_min_epi32(found, within, found, node);
    node = _mm512_add_epi32(_mm512_add_epi32(node, node), _mm512_set1_epi32(1));
    node = _mm512_mask_sub_epi32(node, right, node, _mm512_set1_epi32(-1));
    step16<kAxes, kLevel + 1>(tables, own, node, found);
  }
}

// Sixteen at a time.
template <std::size_t kAxes>
[[gnu::target(RCB_AVX512)]] std::size_t sort_in_avx512(const Axes& x, std::size_t count, const Splitters& splitters,
                                                       std::uint8_t* bucket, geometry::Box& box) {
  const LevelTables tables = tables_of(splitters);
  const RoundedAxes rounded = splitters.rounded;
  __m512d lo[kAxes];
  __m512d hi[kAxes];
  for (std::size_t a = 0; a < kAxes; ++a) {
    lo[a] = _mm512_set1_pd(box.lo[a]);
    hi[a] = _mm512_set1_pd(box.hi[a]);
  }
  std::size_t i = 0;
  for (; i + 16 <= count; i += 16) {
    __m512 own[kAxes];
    for (std::size_t a = 0; a < kAxes; ++a) {
      const __m512d low = _mm512_loadu_pd(x[a] + i);
      const __m512d high = _mm512_loadu_pd(x[a] + i + 8);
      lo[a] = _mm512_min_pd(lo[a], _mm512_min_pd(low, high));
      hi[a] = _mm512_max_pd(hi[a], _mm512_max_pd(low, high));
      own[a] = rounded16(rounded, a, x[a] + i);
    }
    __m512i node = _mm512_setzero_si512();
    __m512i found = _mm512_set1_epi32(kBuckets);
    step16<kAxes>(tables, own, node, found);
    _mm_storeu_si128(reinterpret_cast<__m128i*>(bucket + i), _mm512_cvtepi32_epi8(_mm512_min_epi32(found, node)));
  }
  for (std::size_t a = 0; a < kAxes; ++a)
    for (int lane = 0; lane < 8; ++lane) {
      box.lo[a] = std::min(box.lo[a], lo[a][lane]);
      box.hi[a] = std::max(box.hi[a], hi[a][lane]);
    }
  return i;
}

template <std::size_t kAxes>
std::size_t sort_in_vectors(const Axes& x, std::size_t count, const Splitters& splitters, std::uint8_t* bucket,
                            geometry::Box& box) {
  if (has_avx512()) return sort_in_avx512<kAxes>(x, count, splitters, bucket, box);
  return sort_in_avx2<kAxes>(x, count, splitters, bucket, box);
}
#endif

}  // namespace

geometry::Box sort_into_buckets(const particles::ParticleView& particles, const Splitters& splitters,
                                std::span<std::uint8_t> bucket) {
  const Axes x = particles.all_axes();  // no splitter lies on an axis that they lack
  geometry::Box box;
  std::size_t done = 0;
#if defined(__x86_64__)
  if (has_avx2())
    done = particles.dims > 2 ? sort_in_vectors<3>(x, particles.count, splitters, bucket.data(), box)
                              : sort_in_vectors<2>(x, particles.count, splitters, bucket.data(), box);
#endif
  sort_one_by_one(x, done, particles.count, splitters, bucket.data(), box);
  return box;
}

}  // namespace rcb::partition
