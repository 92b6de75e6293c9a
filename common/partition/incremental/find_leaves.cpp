#include "common/partition/incremental/find_leaves.hpp"

#include <bit>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "common/base/cpu.hpp"
#include "common/base/index.hpp"
#include "common/base/prefetch.hpp"

namespace rcb::partition {
namespace {

using Tables = GuessTables;

// The leaves of those particles from `i` on.
void find_one_by_one(const Tables& t, const Axes& x, std::int32_t* part, std::size_t i, std::size_t count,
                     FoundLeaves& found) {
  for (; i < count; ++i) {
    const std::array<float, 3> own{t.rounded(0, x[0][i]), t.rounded(1, x[1][i]), t.rounded(2, x[2][i])};
    std::size_t leaf = t.below_root ? at(t.first[at(part[i])]) : 0;
    bool out = false;
    for (std::size_t level = 0; level < t.levels; ++level) {
      const float on = own[at(-t.on_y[level][leaf] - 2 * t.on_z[level][leaf])];
      const bool right = on > t.least[level][leaf];
      out |= right & (on < t.most[level][leaf]);
      leaf = at(t.next[level][leaf]) + (right ? 1U : 0U);
    }
    for (std::size_t bit = 0; bit < found.bits.size(); ++bit) found.bits[bit] |= (leaf >> bit & std::uint64_t{1}) << i;
    bool in = true;
    for (std::size_t a = 0; a < own.size(); ++a) in &= (own[a] > t.lo[a][leaf]) & (own[a] < t.hi[a][leaf]);
    part[i] = t.part[leaf];
    found.boundary |= (out ? 1ULL : 0ULL) << i;
    found.unsure |= (in || out ? 0ULL : 1ULL) << i;
  }
}

[[gnu::always_inline]] inline void add_bits(const FoundLeaves& found, std::size_t count, LeafCounts& sums) {
  std::array<std::uint64_t, GuessTables::kLeaves> all;
  for (std::size_t bits = 1; bits < all.size(); ++bits) {
    const std::uint64_t low = found.bits[at(std::countr_zero(bits))];
    const std::size_t others = bits & (bits - 1);
    all[bits] = others == 0 ? low : low & all[others];
    sums[bits] += at(std::popcount(all[bits]));
  }
  sums[0] += count;
}

#if defined(__x86_64__)
[[gnu::target("popcnt")]] void add_bits_with_popcnt(const FoundLeaves& found, std::size_t count, LeafCounts& sums) {
  add_bits(found, count, sums);
}

[[gnu::target(RCB_AVX2), gnu::always_inline]] inline __m256 in_table(const Tables::Floats& table, __m256i index) {
  return _mm256_permutevar8x32_ps(_mm256_load_ps(table.data()), index);
}
[[gnu::target(RCB_AVX2), gnu::always_inline]] inline __m256i in_table(const Tables::Integers& table, __m256i index) {
  return _mm256_permutevar8x32_epi32(_mm256_load_si256(reinterpret_cast<const __m256i*>(table.data())), index);
}

// Returns how many particles it took. Here and below kAxes is 2 where there are no more, else 3.
template <bool kSeveral, std::size_t kAxes>
[[gnu::target(RCB_AVX2)]] std::size_t find_eights(const Tables& t, const Axes& x, std::int32_t* part, std::size_t count,
                                                  FoundLeaves& found) {
  std::size_t i = 0;
  for (; i + 8 <= count; i += 8) {
    __m256 own[kAxes];
    for (std::size_t a = 0; a < kAxes; ++a) {
      prefetch(x[a], i + kParticlesAhead);
      own[a] = rounded8(t.rounded, a, x[a] + i);
    }
    __m256i leaf = _mm256_setzero_si256();
    if constexpr (kSeveral) leaf = in_table(t.first, _mm256_loadu_si256(reinterpret_cast<const __m256i*>(part + i)));
    __m256 out = _mm256_setzero_ps();
    for (std::size_t level = 0; level < t.levels; ++level) {
      __m256 on = _mm256_blendv_ps(own[0], own[1], _mm256_castsi256_ps(in_table(t.on_y[level], leaf)));
      if constexpr (kAxes > 2) on = _mm256_blendv_ps(on, own[2], _mm256_castsi256_ps(in_table(t.on_z[level], leaf)));
      const __m256 right = _mm256_cmp_ps(on, in_table(t.least[level], leaf), _CMP_GT_OQ);
      const __m256 before = _mm256_cmp_ps(on, in_table(t.most[level], leaf), _CMP_LT_OQ);
      out = _mm256_or_ps(out, _mm256_and_ps(right, before));
      leaf = _mm256_sub_epi32(in_table(t.next[level], leaf), _mm256_castps_si256(right));
    }
    for (std::size_t bit = 0; bit < found.bits.size(); ++bit) {
      const __m256i top = _mm256_slli_epi32(leaf, 31 - static_cast<int>(bit));
      found.bits[bit] |= std::uint64_t{static_cast<unsigned>(_mm256_movemask_ps(_mm256_castsi256_ps(top)))} << i;
    }
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(part + i), in_table(t.part, leaf));
    __m256 in = _mm256_castsi256_ps(_mm256_set1_epi32(-1));
    for (std::size_t a = 0; a < kAxes; ++a) {
      in = _mm256_and_ps(in, _mm256_cmp_ps(own[a], in_table(t.lo[a], leaf), _CMP_GT_OQ));
      in = _mm256_and_ps(in, _mm256_cmp_ps(own[a], in_table(t.hi[a], leaf), _CMP_LT_OQ));
    }
    const auto beyond = static_cast<unsigned>(_mm256_movemask_ps(in)) ^ 0xFFU;
    const auto boundary = static_cast<unsigned>(_mm256_movemask_ps(out));
    found.boundary |= std::uint64_t{boundary} << i;
    found.unsure |= std::uint64_t{beyond & ~boundary} << i;
  }
  return i;
}

template <bool kSeveral, std::size_t kAxes>
[[gnu::target(RCB_AVX2)]] FoundLeaves find_in_avx2(const Tables& t, const Axes& x, std::int32_t* part,
                                                   std::size_t count) {
  FoundLeaves found;
  if (const std::size_t i = find_eights<kSeveral, kAxes>(t, x, part, count, found); i < count)
    find_one_by_one(t, x, part, i, count, found);
  return found;
}

[[gnu::target(RCB_AVX512), gnu::always_inline]] inline __m512 in_table16(const Tables::Floats& table, __m512i index) {
  return _mm512_permutexvar_ps(index, _mm512_broadcast_f32x8(_mm256_load_ps(table.data())));
}
[[gnu::target(RCB_AVX512), gnu::always_inline]] inline __m512i in_table16(const Tables::Integers& table,
                                                                          __m512i index) {
  const __m256i eight = _mm256_load_si256(reinterpret_cast<const __m256i*>(table.data()));
  return _mm512_permutexvar_epi32(index, _mm512_broadcast_i32x8(eight));
}

// a where `all` has every bit set, b where it has none.
[[gnu::target(RCB_AVX512), gnu::always_inline]] inline __m512 pick(__m512i all, __m512 a, __m512 b) {
  return _mm512_castsi512_ps(_mm512_ternarylogic_epi32(all, _mm512_castps_si512(a), _mm512_castps_si512(b), 0xCA));
}

template <bool kSeveral, std::size_t kAxes>
[[gnu::target(RCB_AVX512)]] FoundLeaves find_in_avx512(const Tables& t, const Axes& x, std::int32_t* part,
                                                       std::size_t count) {
  FoundLeaves found;
  const __m512i bit0 = _mm512_set1_epi32(1);
  const __m512i bit1 = _mm512_set1_epi32(2);
  const __m512i bit2 = _mm512_set1_epi32(4);
  std::size_t i = 0;
  for (; i + 16 <= count; i += 16) {
    __m512 own[kAxes];
    for (std::size_t a = 0; a < kAxes; ++a) {
      prefetch(x[a], i + kParticlesAhead);
      prefetch(x[a], i + kParticlesAhead + 8);
      own[a] = rounded16(t.rounded, a, x[a] + i);
    }
    __m512i leaf = _mm512_setzero_si512();
    if constexpr (kSeveral) leaf = in_table16(t.first, _mm512_loadu_si512(part + i));
    __mmask16 out = 0;
    for (std::size_t level = 0; level < t.levels; ++level) {
      __m512 on = pick(in_table16(t.on_y[level], leaf), own[1], own[0]);
      if constexpr (kAxes > 2) on = pick(in_table16(t.on_z[level], leaf), own[2], on);
      const __mmask16 right = _mm512_cmp_ps_mask(on, in_table16(t.least[level], leaf), _CMP_GT_OQ);
      out = _kor_mask16(out, _mm512_mask_cmp_ps_mask(right, on, in_table16(t.most[level], leaf), _CMP_LT_OQ));
      leaf = in_table16(t.next[level], leaf);
      leaf = _mm512_mask_add_epi32(leaf, right, leaf, bit0);
    }
    found.bits[0] |= std::uint64_t{_mm512_test_epi32_mask(leaf, bit0)} << i;
    found.bits[1] |= std::uint64_t{_mm512_test_epi32_mask(leaf, bit1)} << i;
    found.bits[2] |= std::uint64_t{_mm512_test_epi32_mask(leaf, bit2)} << i;
    _mm512_storeu_si512(part + i, in_table16(t.part, leaf));
    __mmask16 in = 0xFFFF;
    for (std::size_t a = 0; a < kAxes; ++a) {
      const __mmask16 above = _mm512_cmp_ps_mask(own[a], in_table16(t.lo[a], leaf), _CMP_GT_OQ);
      in = _kand_mask16(in, _mm512_mask_cmp_ps_mask(above, own[a], in_table16(t.hi[a], leaf), _CMP_LT_OQ));
    }
    found.boundary |= std::uint64_t{out} << i;
    found.unsure |= std::uint64_t{_knot_mask16(_kor_mask16(in, out))} << i;
  }
  if (i < count) find_one_by_one(t, x, part, i, count, found);
  return found;
}

template <bool kSeveral, std::size_t kAxes>
FoundLeaves find_in_vectors(const Tables& t, const Axes& x, std::int32_t* part, std::size_t count) {
  if (has_avx512()) return find_in_avx512<kSeveral, kAxes>(t, x, part, count);
  return find_in_avx2<kSeveral, kAxes>(t, x, part, count);
}
#endif

}  // namespace

FoundLeaves find_leaves(const GuessTables& tables, const Axes& x, std::int32_t* part, std::size_t count) {
#if defined(__x86_64__)
  if (has_avx2()) {
    if (tables.dims > 2)
      return tables.below_root ? find_in_vectors<true, 3>(tables, x, part, count)
                               : find_in_vectors<false, 3>(tables, x, part, count);
    return tables.below_root ? find_in_vectors<true, 2>(tables, x, part, count)
                             : find_in_vectors<false, 2>(tables, x, part, count);
  }
#endif
  FoundLeaves found;
  find_one_by_one(tables, x, part, 0, count, found);
  return found;
}

void add_leaves(const FoundLeaves& found, std::size_t count, LeafCounts& sums) {
#if defined(__x86_64__)
  if (has_avx2()) return add_bits_with_popcnt(found, count, sums);
#endif
  add_bits(found, count, sums);
}

LeafCounts counts_of(LeafCounts sums) {
  for (std::size_t bit = 1; bit < sums.size(); bit *= 2)
    for (std::size_t leaf = 0; leaf < sums.size(); ++leaf)
      if ((leaf & bit) == 0) sums[leaf] -= sums[leaf | bit];
  return sums;
}

}  // namespace rcb::partition
