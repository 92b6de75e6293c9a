#include "common/partition/incremental/find_leaves.hpp"

#include <bit>
#include <limits>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "common/base/cpu.hpp"
#include "common/base/index.hpp"
#include "common/geometry/axes.hpp"

namespace rcb::partition {
namespace {

using Tables = GuessTables;
using particles::kBlock;

// The leaves of those particles from `i` on.
void find_one_by_one(const Tables& t, const Axes& x, std::int32_t* part, std::size_t i, std::size_t count,
                     FoundLeaves& found) {
  for (; i < count; ++i) {
    const std::array<float, 3> own{t.rounded(0, x[0][i]), t.rounded(1, x[1][i]), t.rounded(2, x[2][i])};
    std::size_t leaf = t.several ? at(t.first[at(part[i])]) : 0;
    bool out = false;
    for (std::size_t level = 0; level < at(kGuessLevels); ++level) {
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

#if defined(__x86_64__)
[[gnu::always_inline]]
#endif
inline void
add_bits(const FoundLeaves& found, std::size_t count, LeafCounts& sums) {
  std::array<std::uint64_t, GuessTables::kLeaves> all;
  for (std::size_t bits = 1; bits < all.size(); ++bits) {
    const std::uint64_t low = found.bits[at(std::countr_zero(bits))];
    const std::size_t others = bits & (bits - 1);
    all[bits] = others == 0 ? low : low & all[others];
    sums[bits] += at(std::popcount(all[bits]));
  }
  sums[0] += count;
}

// What the keys of a block's unsure particles tell, one bit each.
struct ByKey {
  std::uint64_t interior = 0;
  std::uint64_t beyond = 0;  // of these, outside of their leaf's box
  std::array<std::uint64_t, 3> bits{};
};

// Of each of those particles, one after the other: its leaf, and whether it is interior.
struct LeafByKey {
  std::array<std::uint32_t, kBlock> leaf;
  std::array<std::uint32_t, kBlock> interior;  // 1 or 0
};

// Without branches, which would be mispredicted.
ByKey take_leaves(const Tables& t, const Axes& x, const LeafByKey& own, std::uint64_t which, std::int32_t* part) {
  ByKey by_key;
  for (std::size_t j = 0; which != 0; which &= which - 1, ++j) {
    const auto k = at(std::countr_zero(which));
    const std::uint32_t leaf = own.leaf[j];
    std::uint32_t in = 1;
    for (std::size_t a = 0; a < x.size(); ++a)
      in &= static_cast<std::uint32_t>(x[a][k] >= t.box_lo[a][leaf]) &
            static_cast<std::uint32_t>(x[a][k] <= t.box_hi[a][leaf]);
    by_key.interior |= std::uint64_t{own.interior[j]} << k;
    by_key.beyond |= std::uint64_t{own.interior[j] & (in ^ 1U)} << k;
    for (std::size_t bit = 0; bit < by_key.bits.size(); ++bit) by_key.bits[bit] |= std::uint64_t{leaf >> bit & 1U} << k;
    part[k] ^= (part[k] ^ t.part[leaf]) & -static_cast<std::int32_t>(own.interior[j]);
  }
  return by_key;
}

ByKey find_keys_one_by_one(const Tables& t, const Axes& x, const particles::Id* id, std::int32_t* part,
                           std::uint64_t which) {
  constexpr std::size_t kWords = geometry::kDimsMax + 1;
  LeafByKey own_leaf;
  std::uint64_t still = which;
  for (std::size_t j = 0; still != 0; still &= still - 1, ++j) {
    const auto k = at(std::countr_zero(still));
    std::array<std::int64_t, kWords> own{0, 0, 0, id[k]};
    for (std::size_t a = 0; a < at(t.dims); ++a)
      own[a] = static_cast<std::int64_t>(geometry::order_bits(x[a][k]) ^ (std::uint64_t{1} << 63U));
    auto n = at(t.several ? t.first[at(part[k])] : 0);
    bool sure = true;
    for (const Tables::Keys& keys : t.keys) {
      const auto sign = [&](const auto& of) {
        for (std::size_t w = 0; w < kWords; ++w) {
          const std::int64_t word = own[w + 1 < kWords ? at(keys.axis[w][n]) : w];
          if (word != of[w][n]) return word < of[w][n] ? -1 : 1;
        }
        return 0;
      };
      const bool right = sign(keys.most) > 0;
      sure &= right || sign(keys.least) < 0;
      n = at(keys.next[n]) + (right ? 1U : 0U);
    }
    own_leaf.leaf[j] = static_cast<std::uint32_t>(n);
    own_leaf.interior[j] = sure ? 1 : 0;
  }
  return take_leaves(t, x, own_leaf, which, part);
}

#if defined(__x86_64__)
[[gnu::target("popcnt")]] void add_bits_with_popcnt(const FoundLeaves& found, std::size_t count, LeafCounts& sums) {
  add_bits(found, count, sums);
}

// Particles that are prefetched ahead: the work on a block's unsure and boundary particles would otherwise wait for
// memory.
constexpr std::size_t kBlocksAhead = 16;
constexpr std::size_t kParticlesAhead = kBlocksAhead * kBlock;

[[gnu::target("avx2"), gnu::always_inline]] inline __m256 as_floats(const double* x, double origin, double scale) {
  const __m256d o = _mm256_set1_pd(origin);
  const __m256d s = _mm256_set1_pd(scale);
  return _mm256_set_m128(_mm256_cvtpd_ps(_mm256_mul_pd(_mm256_sub_pd(_mm256_loadu_pd(x + 4), o), s)),
                         _mm256_cvtpd_ps(_mm256_mul_pd(_mm256_sub_pd(_mm256_loadu_pd(x), o), s)));
}
[[gnu::target("avx2"), gnu::always_inline]] inline __m256 in_table(const Tables::Floats& table, __m256i index) {
  return _mm256_permutevar8x32_ps(_mm256_load_ps(table.data()), index);
}
[[gnu::target("avx2"), gnu::always_inline]] inline __m256i in_table(const Tables::Integers& table, __m256i index) {
  return _mm256_permutevar8x32_epi32(_mm256_load_si256(reinterpret_cast<const __m256i*>(table.data())), index);
}

// Returns how many particles it took.
template <bool kSeveral>
[[gnu::target("avx2,popcnt")]] std::size_t find_eights(const Tables& t, const Axes& x, std::int32_t* part,
                                                       std::size_t count, FoundLeaves& found) {
  std::size_t i = 0;
  for (; i + 8 <= count; i += 8) {
    for (const double* axis : x) _mm_prefetch(axis + i + kParticlesAhead, _MM_HINT_T0);
    const __m256 own[3] = {as_floats(x[0] + i, t.origin[0], t.scale[0]), as_floats(x[1] + i, t.origin[1], t.scale[1]),
                           as_floats(x[2] + i, t.origin[2], t.scale[2])};
    __m256i leaf = _mm256_setzero_si256();
    if constexpr (kSeveral) leaf = in_table(t.first, _mm256_loadu_si256(reinterpret_cast<const __m256i*>(part + i)));
    __m256 out = _mm256_setzero_ps();
    for (std::size_t level = 0; level < at(kGuessLevels); ++level) {
      const __m256 low = _mm256_blendv_ps(own[0], own[1], _mm256_castsi256_ps(in_table(t.on_y[level], leaf)));
      const __m256 on = _mm256_blendv_ps(low, own[2], _mm256_castsi256_ps(in_table(t.on_z[level], leaf)));
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
    for (std::size_t a = 0; a < at(geometry::kDimsMax); ++a) {
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

template <bool kSeveral>
[[gnu::target("avx2,popcnt")]] FoundLeaves find_in_avx2(const Tables& t, const Axes& x, std::int32_t* part,
                                                        std::size_t count) {
  FoundLeaves found;
  if (const std::size_t i = find_eights<kSeveral>(t, x, part, count, found); i < count)
    find_one_by_one(t, x, part, i, count, found);
  return found;
}

[[gnu::target("avx2"), gnu::always_inline]] inline __m256i four_words(const std::array<std::int64_t, 4>& words) {
  return _mm256_load_si256(reinterpret_cast<const __m256i*>(&words));
}
// Which words of a are greater than those of b; the first word is the highest bit.
[[gnu::target("avx2"), gnu::always_inline]] inline int greater(__m256i a, __m256i b) {
  return _mm256_movemask_pd(_mm256_castsi256_pd(_mm256_cmpgt_epi64(a, b)));
}
// All words of a key are compared at once, and the first that differs decides. Without branches: on planes that hold
// many particles they would be mispredicted.
[[gnu::target("avx2,bmi")]] ByKey find_keys_in_avx2(const Tables& t, const Axes& x, const particles::Id* id,
                                                    std::int32_t* part, std::uint64_t which) {
  const auto mask = [&t](int a) { return a < t.dims ? -1LL : 0LL; };
  const __m256i used = _mm256_set_epi64x(0, mask(2), mask(1), mask(0));
  LeafByKey own_leaf;
  std::uint64_t still = which;
  for (std::size_t j = 0; still != 0; still &= still - 1, ++j) {
    const auto k = at(std::countr_zero(still));
    // Both zeros are one place.
    const __m256d point = _mm256_add_pd(_mm256_set_pd(0, x[2][k], x[1][k], x[0][k]), _mm256_setzero_pd());
    __m256i own = _mm256_and_si256(_mm256_castpd_si256(point), used);
    const __m256i turn = _mm256_srli_epi64(_mm256_cmpgt_epi64(_mm256_setzero_si256(), own), 1);
    own = _mm256_insert_epi64(_mm256_xor_si256(own, turn), id[k], 3);
    std::int32_t node = t.several ? t.first[at(part[k])] : 0;
    bool sure = true;
    for (const auto& level : t.steps) {
      const Tables::Step& step = level[at(node)];
      const __m256i order = _mm256_load_si256(reinterpret_cast<const __m256i*>(step.order.data()));
      const __m256i key = _mm256_permutevar8x32_epi32(own, order);
      const __m256i least = four_words(step.least);
      const __m256i most = four_words(step.most);
      const bool left = greater(least, key) > greater(key, least);
      const bool right = greater(key, most) > greater(most, key);
      sure &= left | right;
      node = step.next + static_cast<std::int32_t>(right);
    }
    own_leaf.leaf[j] = static_cast<std::uint32_t>(node);
    own_leaf.interior[j] = sure ? 1 : 0;
  }
  return take_leaves(t, x, own_leaf, which, part);
}

#define RCB_AVX512 "avx512f,avx512dq,avx512bw,avx512vl,avx2,popcnt,bmi2"
using Words = __m512i;

[[gnu::target(RCB_AVX512), gnu::always_inline]] inline __m512 as_floats16(const double* x, double origin,
                                                                          double scale) {
  const __m512d o = _mm512_set1_pd(origin);
  const __m512d s = _mm512_set1_pd(scale);
  const __m256 low = _mm512_cvtpd_ps(_mm512_mul_pd(_mm512_sub_pd(_mm512_loadu_pd(x), o), s));
  const __m256 high = _mm512_cvtpd_ps(_mm512_mul_pd(_mm512_sub_pd(_mm512_loadu_pd(x + 8), o), s));
  return _mm512_insertf32x8(_mm512_castps256_ps512(low), high, 1);
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

template <bool kSeveral>
[[gnu::target(RCB_AVX512)]] FoundLeaves find_in_avx512(const Tables& t, const Axes& x, std::int32_t* part,
                                                       std::size_t count) {
  FoundLeaves found;
  const __m512i bit0 = _mm512_set1_epi32(1);
  const __m512i bit1 = _mm512_set1_epi32(2);
  const __m512i bit2 = _mm512_set1_epi32(4);
  std::size_t i = 0;
  for (; i + 16 <= count; i += 16) {
    for (const double* axis : x) {
      _mm_prefetch(axis + i + kParticlesAhead, _MM_HINT_T0);
      _mm_prefetch(axis + i + kParticlesAhead + 8, _MM_HINT_T0);
    }
    const __m512 own[3] = {as_floats16(x[0] + i, t.origin[0], t.scale[0]),
                           as_floats16(x[1] + i, t.origin[1], t.scale[1]),
                           as_floats16(x[2] + i, t.origin[2], t.scale[2])};
    __m512i leaf = _mm512_setzero_si512();
    if constexpr (kSeveral) leaf = in_table16(t.first, _mm512_loadu_si512(part + i));
    __mmask16 out = 0;
    for (std::size_t level = 0; level < at(kGuessLevels); ++level) {
      const __m512 on =
          pick(in_table16(t.on_z[level], leaf), own[2], pick(in_table16(t.on_y[level], leaf), own[1], own[0]));
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
    for (std::size_t a = 0; a < at(geometry::kDimsMax); ++a) {
      const __mmask16 above = _mm512_cmp_ps_mask(own[a], in_table16(t.lo[a], leaf), _CMP_GT_OQ);
      in = _kand_mask16(in, _mm512_mask_cmp_ps_mask(above, own[a], in_table16(t.hi[a], leaf), _CMP_LT_OQ));
    }
    found.boundary |= std::uint64_t{out} << i;
    found.unsure |= std::uint64_t{_knot_mask16(_kor_mask16(in, out))} << i;
  }
  if (i < count) find_one_by_one(t, x, part, i, count, found);
  return found;
}

// Those whose bits are set in `which`, side by side.
template <typename T>
[[gnu::target(RCB_AVX512), gnu::always_inline]] inline void pick_eights(const T* from, std::uint64_t which, T* to) {
  static_assert(sizeof(T) == 8);
  for (std::size_t i = 0; i < kBlock && which >> i != 0; i += 8) {
    const auto some = static_cast<__mmask8>(which >> i);
    _mm512_storeu_si512(to, _mm512_maskz_compress_epi64(some, _mm512_maskz_loadu_epi64(some, from + i)));
    to += std::popcount(unsigned{some});
  }
}

// A word of each of sixteen keys, or the node of each; and one bit of each.
struct Sixteen {
  Words words[2];
};
using Masks = std::array<unsigned, 2>;

// How sixteen keys compare with the brackets of their nodes, one bit each.
struct Undecided {
  Masks before{};           // less than `least`
  Masks behind{};           // greater than `most`
  Masks least{0xFF, 0xFF};  // equal to it so far
  Masks most{0xFF, 0xFF};
};
// By their next word.
[[gnu::target(RCB_AVX512), gnu::always_inline]] inline void compare(const Sixteen& word, const Sixteen& node,
                                                                    const Tables::Words& least,
                                                                    const Tables::Words& most, Undecided& state) {
  for (std::size_t h = 0; h < 2; ++h) {
    const Words from = _mm512_permutexvar_epi64(node.words[h], _mm512_loadu_si512(least.data()));
    const Words to = _mm512_permutexvar_epi64(node.words[h], _mm512_loadu_si512(most.data()));
    state.before[h] |= state.least[h] & _mm512_cmplt_epi64_mask(word.words[h], from);
    state.behind[h] |= state.most[h] & _mm512_cmpgt_epi64_mask(word.words[h], to);
    state.least[h] &= _mm512_cmpeq_epi64_mask(word.words[h], from);
    state.most[h] &= _mm512_cmpeq_epi64_mask(word.words[h], to);
  }
}

// Sixteen keys at once, without branches: on planes that hold many particles they would be mispredicted. Ids are read
// only where all coordinates are equal.
[[gnu::target(RCB_AVX512)]] ByKey find_keys_in_avx512(const Tables& t, const Axes& x, const particles::Id* id,
                                                      std::int32_t* part, std::uint64_t which) {
  constexpr std::size_t kAxes = geometry::kDimsMax;
  // The unsure ones side by side.
  alignas(64) std::array<std::array<double, kBlock>, kAxes> position;
  alignas(64) std::array<particles::Id, kBlock> own_id;
  alignas(64) std::array<std::int32_t, kBlock> part_so_far;
  bool has_ids = false;
  for (std::size_t a = 0; a < kAxes; ++a) pick_eights(x[a], which, position[a].data());
  std::uint64_t still = t.several ? which : 0;
  for (std::size_t j = 0; still != 0; still &= still - 1, ++j) part_so_far[j] = part[std::countr_zero(still)];
  const auto count = at(std::popcount(which));
  const Words one = _mm512_set1_epi64(1);
  const Words two = _mm512_set1_epi64(2);
  const Words four = _mm512_set1_epi64(4);
  const Words top = _mm512_set1_epi64(std::numeric_limits<std::int64_t>::max());
  // Of the unsure ones in their order.
  std::uint64_t sure = 0;
  std::uint64_t inside = 0;
  std::array<std::uint64_t, 3> bits{};
  for (std::size_t j = 0; j < count; j += 16) {
    std::array<Sixteen, kAxes> own;
    Sixteen node;
    for (std::size_t h = 0; h < 2; ++h) {
      for (std::size_t a = 0; a < kAxes; ++a) {
        // Both zeros are one place.
        const __m512d value = _mm512_add_pd(_mm512_load_pd(position[a].data() + j + 8 * h), _mm512_setzero_pd());
        const Words raw = a < at(t.dims) ? _mm512_castpd_si512(value) : _mm512_setzero_si512();
        own[a].words[h] = _mm512_mask_xor_epi64(raw, _mm512_movepi64_mask(raw), raw, top);
      }
      node.words[h] = _mm512_setzero_si512();
      if (t.several) {
        const __m256i parts = _mm256_load_si256(reinterpret_cast<const __m256i*>(part_so_far.data() + j + 8 * h));
        const __m256i first = _mm256_load_si256(reinterpret_cast<const __m256i*>(t.first.data()));
        node.words[h] = _mm512_cvtepi32_epi64(_mm256_permutevar8x32_epi32(first, parts));
      }
    }
    const unsigned lanes = count - j < 16 ? (1U << (count - j)) - 1 : 0xFFFF;
    Masks known{lanes & 0xFF, lanes >> 8U};
    for (const Tables::Keys& keys : t.keys) {
      Undecided state;
      for (std::size_t w = 0; w < (keys.whole ? kAxes : 1); ++w) {
        Sixteen word;
        for (std::size_t h = 0; h < 2; ++h) {
          const Words axis = _mm512_permutexvar_epi64(node.words[h], _mm512_loadu_si512(keys.axis[w].data()));
          const Words low =
              _mm512_mask_blend_epi64(_mm512_test_epi64_mask(axis, one), own[0].words[h], own[1].words[h]);
          word.words[h] = _mm512_mask_blend_epi64(_mm512_test_epi64_mask(axis, two), low, own[2].words[h]);
        }
        compare(word, node, keys.least[w], keys.most[w], state);
      }
      const unsigned open =
          ((state.least[0] | state.most[0]) & known[0]) | ((state.least[1] | state.most[1]) & known[1]);
      if (keys.whole && open != 0) {
        if (!has_ids) {
          pick_eights(id, which, own_id.data());
          for (std::size_t i = 0; i < kBlock; i += 8) _mm_prefetch(id + kParticlesAhead + i, _MM_HINT_T0);
          has_ids = true;
        }
        const Sixteen word{{_mm512_load_si512(own_id.data() + j), _mm512_load_si512(own_id.data() + j + 8)}};
        compare(word, node, keys.least.back(), keys.most.back(), state);
      }
      for (std::size_t h = 0; h < 2; ++h) {
        known[h] &= state.before[h] | state.behind[h];
        const Words next = _mm512_permutexvar_epi64(node.words[h], _mm512_loadu_si512(keys.next.data()));
        node.words[h] = _mm512_mask_add_epi64(next, static_cast<__mmask8>(state.behind[h]), next, one);
      }
    }
    for (std::size_t h = 0; h < 2; ++h) {
      unsigned in = 0xFF;
      for (std::size_t a = 0; a < kAxes; ++a) {
        const __m512d value = _mm512_load_pd(position[a].data() + j + 8 * h);
        const __m512d lo = _mm512_permutexvar_pd(node.words[h], _mm512_loadu_pd(t.box_lo[a].data()));
        const __m512d hi = _mm512_permutexvar_pd(node.words[h], _mm512_loadu_pd(t.box_hi[a].data()));
        in &= unsigned{_mm512_cmp_pd_mask(value, lo, _CMP_GE_OQ)} & _mm512_cmp_pd_mask(value, hi, _CMP_LE_OQ);
      }
      sure |= std::uint64_t{known[h]} << (j + 8 * h);
      inside |= std::uint64_t{in} << (j + 8 * h);
      bits[0] |= std::uint64_t{_mm512_test_epi64_mask(node.words[h], one)} << (j + 8 * h);
      bits[1] |= std::uint64_t{_mm512_test_epi64_mask(node.words[h], two)} << (j + 8 * h);
      bits[2] |= std::uint64_t{_mm512_test_epi64_mask(node.words[h], four)} << (j + 8 * h);
    }
  }
  ByKey by_key{_pdep_u64(sure, which), _pdep_u64(sure & ~inside, which), {}};
  for (std::size_t bit = 0; bit < bits.size(); ++bit) by_key.bits[bit] = _pdep_u64(bits[bit], which);
  for (std::size_t i = 0; i < kBlock && by_key.interior >> i != 0; i += 16) {
    __m512i leaf = _mm512_maskz_set1_epi32(static_cast<__mmask16>(by_key.bits[0] >> i), 1);
    leaf = _mm512_mask_add_epi32(leaf, static_cast<__mmask16>(by_key.bits[1] >> i), leaf, _mm512_set1_epi32(2));
    leaf = _mm512_mask_add_epi32(leaf, static_cast<__mmask16>(by_key.bits[2] >> i), leaf, _mm512_set1_epi32(4));
    _mm512_mask_storeu_epi32(part + i, static_cast<__mmask16>(by_key.interior >> i), in_table16(t.part, leaf));
  }
  return by_key;
}
#endif

ByKey find_keys(const Tables& t, const Axes& x, const particles::Id* id, std::int32_t* part, std::uint64_t which) {
#if defined(__x86_64__)
  if (has_avx512()) return find_keys_in_avx512(t, x, id, part, which);
  if (has_avx2()) return find_keys_in_avx2(t, x, id, part, which);
#endif
  return find_keys_one_by_one(t, x, id, part, which);
}

}  // namespace

FoundLeaves find_leaves(const GuessTables& tables, const Axes& x, std::int32_t* part, std::size_t count) {
#if defined(__x86_64__)
  if (has_avx512()) {
    if (tables.several) return find_in_avx512<true>(tables, x, part, count);
    return find_in_avx512<false>(tables, x, part, count);
  }
  if (has_avx2()) {
    if (tables.several) return find_in_avx2<true>(tables, x, part, count);
    return find_in_avx2<false>(tables, x, part, count);
  }
#endif
  FoundLeaves found;
  find_one_by_one(tables, x, part, 0, count, found);
  return found;
}

std::uint64_t find_leaves_by_key(const GuessTables& tables, const Axes& x, const particles::Id* id, std::int32_t* part,
                                 FoundLeaves& found) {
  const ByKey by_key = find_keys(tables, x, id, part, found.unsure);
  found.boundary |= found.unsure & ~by_key.interior;
  for (std::size_t bit = 0; bit < found.bits.size(); ++bit)
    found.bits[bit] = (found.bits[bit] & ~by_key.interior) | (by_key.bits[bit] & by_key.interior);
  return by_key.beyond;
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
