// The leaves of a block's particles by their whole keys.
#include <bit>
#include <limits>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "common/base/cpu.hpp"
#include "common/base/index.hpp"
#include "common/base/prefetch.hpp"
#include "common/geometry/axes.hpp"
#include "common/partition/incremental/find_leaves.hpp"

namespace rcb::partition {
namespace {

using Tables = GuessTables;
using particles::kBlock;

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

// What these tell of the particles; the interior ones get their part. Without branches, which would be mispredicted.
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
    auto n = at(t.below_root ? t.first[at(part[k])] : 0);
    bool sure = true;
    for (const Tables::Keys& keys : std::span(t.keys).first(t.levels)) {
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
[[gnu::target(RCB_AVX2), gnu::always_inline]] inline __m256i four_words(const std::array<std::int64_t, 4>& words) {
  return _mm256_load_si256(reinterpret_cast<const __m256i*>(&words));
}
// Which words of a are greater than those of b; the first word is the highest bit.
[[gnu::target(RCB_AVX2), gnu::always_inline]] inline int greater(__m256i a, __m256i b) {
  return _mm256_movemask_pd(_mm256_castsi256_pd(_mm256_cmpgt_epi64(a, b)));
}
// All words of a key are compared at once, and the first that differs decides. Without branches: on planes that hold
// many particles they would be mispredicted.
[[gnu::target(RCB_AVX2)]] ByKey find_keys_in_avx2(const Tables& t, const Axes& x, const particles::Id* id,
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
    std::int32_t node = t.below_root ? t.first[at(part[k])] : 0;
    bool sure = true;
    for (const auto& level : std::span(t.steps).first(t.levels)) {
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

using Words = __m512i;

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
struct Compared {
  Masks before{};           // less than `least`
  Masks behind{};           // greater than `most`
  Masks least{0xFF, 0xFF};  // equal to it so far
  Masks most{0xFF, 0xFF};

  bool any_open(const Masks& of) const {
    return (((least[0] | most[0]) & of[0]) | ((least[1] | most[1]) & of[1])) != 0;
  }
};
// By their next word.
[[gnu::target(RCB_AVX512), gnu::always_inline]] inline void compare(const Sixteen& word, const Sixteen& node,
                                                                    const Tables::Words& least,
                                                                    const Tables::Words& most, Compared& state) {
  for (std::size_t h = 0; h < 2; ++h) {
    const Words from = _mm512_permutexvar_epi64(node.words[h], _mm512_loadu_si512(least.data()));
    const Words to = _mm512_permutexvar_epi64(node.words[h], _mm512_loadu_si512(most.data()));
    state.before[h] |= state.least[h] & _mm512_cmplt_epi64_mask(word.words[h], from);
    state.behind[h] |= state.most[h] & _mm512_cmpgt_epi64_mask(word.words[h], to);
    state.least[h] &= _mm512_cmpeq_epi64_mask(word.words[h], from);
    state.most[h] &= _mm512_cmpeq_epi64_mask(word.words[h], to);
  }
}

// The unsure particles of a block side by side.
struct Unsure {
  alignas(64) std::array<std::array<double, kBlock>, geometry::kDimsMax> position;
  alignas(64) std::array<particles::Id, kBlock> id;
  alignas(64) std::array<std::int32_t, kBlock> part;
  bool has_ids = false;
};

// The order words of sixteen of them on an axis, from the j-th on.
[[gnu::target(RCB_AVX512), gnu::always_inline]] inline Sixteen order_words(const double* position, std::size_t j) {
  const Words top = _mm512_set1_epi64(std::numeric_limits<std::int64_t>::max());
  Sixteen own;
  for (std::size_t h = 0; h < 2; ++h) {
    // Both zeros are one place.
    const __m512d value = _mm512_add_pd(_mm512_load_pd(position + j + 8 * h), _mm512_setzero_pd());
    const Words bits = _mm512_castpd_si512(value);
    own.words[h] = _mm512_mask_xor_epi64(bits, _mm512_movepi64_mask(bits), bits, top);
  }
  return own;
}

// Each one's word on the axis of its node.
[[gnu::target(RCB_AVX512), gnu::always_inline]] inline Sixteen on_axis(
    const std::array<Sixteen, geometry::kDimsMax>& own, const Sixteen& node, const Tables::Words& axis_of) {
  Sixteen word;
  for (std::size_t h = 0; h < 2; ++h) {
    const Words axis = _mm512_permutexvar_epi64(node.words[h], _mm512_loadu_si512(axis_of.data()));
    const __mmask8 y = _mm512_test_epi64_mask(axis, _mm512_set1_epi64(1));
    const __mmask8 z = _mm512_test_epi64_mask(axis, _mm512_set1_epi64(2));
    const Words low = _mm512_mask_blend_epi64(y, own[0].words[h], own[1].words[h]);
    word.words[h] = _mm512_mask_blend_epi64(z, low, own[2].words[h]);
  }
  return word;
}

// Which lie in the boxes of their leaves.
[[gnu::target(RCB_AVX512), gnu::always_inline]] inline Masks in_boxes(const Tables& t, const Unsure& unsure,
                                                                      std::size_t j, const Sixteen& leaf) {
  Masks in{0xFF, 0xFF};
  for (std::size_t h = 0; h < 2; ++h)
    for (std::size_t a = 0; a < unsure.position.size(); ++a) {
      const __m512d value = _mm512_load_pd(unsure.position[a].data() + j + 8 * h);
      const __m512d lo = _mm512_permutexvar_pd(leaf.words[h], _mm512_loadu_pd(t.box_lo[a].data()));
      const __m512d hi = _mm512_permutexvar_pd(leaf.words[h], _mm512_loadu_pd(t.box_hi[a].data()));
      in[h] &= unsigned{_mm512_cmp_pd_mask(value, lo, _CMP_GE_OQ)} & _mm512_cmp_pd_mask(value, hi, _CMP_LE_OQ);
    }
  return in;
}

// Of the interior ones.
[[gnu::target(RCB_AVX512), gnu::always_inline]] inline void write_parts(const Tables& t, const ByKey& by_key,
                                                                        std::int32_t* part) {
  // Leaves are less than 8: the upper half doesn't matter.
  const __m512i parts = _mm512_castsi256_si512(_mm256_load_si256(reinterpret_cast<const __m256i*>(t.part.data())));
  for (std::size_t i = 0; i < kBlock && by_key.interior >> i != 0; i += 16) {
    __m512i leaf = _mm512_maskz_set1_epi32(static_cast<__mmask16>(by_key.bits[0] >> i), 1);
    leaf = _mm512_mask_add_epi32(leaf, static_cast<__mmask16>(by_key.bits[1] >> i), leaf, _mm512_set1_epi32(2));
    leaf = _mm512_mask_add_epi32(leaf, static_cast<__mmask16>(by_key.bits[2] >> i), leaf, _mm512_set1_epi32(4));
    _mm512_mask_storeu_epi32(part + i, static_cast<__mmask16>(by_key.interior >> i),
                             _mm512_permutexvar_epi32(leaf, parts));
  }
}

// Sixteen keys at once, without branches: on planes that hold many particles they would be mispredicted. Ids are read
// only where all coordinates are equal.
[[gnu::target(RCB_AVX512)]] ByKey find_keys_in_avx512(const Tables& t, const Axes& x, const particles::Id* id,
                                                      std::int32_t* part, std::uint64_t which) {
  Unsure unsure;
  for (std::size_t a = 0; a < x.size(); ++a) pick_eights(x[a], which, unsure.position[a].data());
  std::uint64_t still = t.below_root ? which : 0;
  for (std::size_t j = 0; still != 0; still &= still - 1, ++j) unsure.part[j] = part[std::countr_zero(still)];
  const auto count = at(std::popcount(which));
  // Of the unsure ones in their order.
  std::uint64_t sure = 0;
  std::uint64_t inside = 0;
  std::array<std::uint64_t, 3> bits{};
  for (std::size_t j = 0; j < count; j += 16) {
    std::array<Sixteen, geometry::kDimsMax> own;
    for (std::size_t a = 0; a < own.size(); ++a)
      own[a] = a < at(t.dims) ? order_words(unsure.position[a].data(), j) : Sixteen{};
    Sixteen node{};
    for (std::size_t h = 0; h < 2 && t.below_root; ++h) {
      const __m256i parts = _mm256_load_si256(reinterpret_cast<const __m256i*>(unsure.part.data() + j + 8 * h));
      const __m256i first = _mm256_load_si256(reinterpret_cast<const __m256i*>(t.first.data()));
      node.words[h] = _mm512_cvtepi32_epi64(_mm256_permutevar8x32_epi32(first, parts));
    }
    const unsigned lanes = count - j < 16 ? (1U << (count - j)) - 1 : 0xFFFF;
    Masks known{lanes & 0xFF, lanes >> 8U};
    for (const Tables::Keys& keys : std::span(t.keys).first(t.levels)) {
      Compared state;
      for (std::size_t w = 0; w < (keys.whole ? own.size() : 1); ++w)
        compare(on_axis(own, node, keys.axis[w]), node, keys.least[w], keys.most[w], state);
      if (keys.whole && state.any_open(known)) {
        if (!unsure.has_ids) {
          pick_eights(id, which, unsure.id.data());
          for (std::size_t i = 0; i < kBlock; i += 8) prefetch(id, kParticlesAhead + i);
          unsure.has_ids = true;
        }
        const Sixteen ids{{_mm512_load_si512(unsure.id.data() + j), _mm512_load_si512(unsure.id.data() + j + 8)}};
        compare(ids, node, keys.least.back(), keys.most.back(), state);
      }
      for (std::size_t h = 0; h < 2; ++h) {
        known[h] &= state.before[h] | state.behind[h];
        const Words next = _mm512_permutexvar_epi64(node.words[h], _mm512_loadu_si512(keys.next.data()));
        const auto right = static_cast<__mmask8>(state.behind[h]);
        node.words[h] = _mm512_mask_add_epi64(next, right, next, _mm512_set1_epi64(1));
      }
    }
    const Masks in = in_boxes(t, unsure, j, node);
    for (std::size_t h = 0; h < 2; ++h) {
      sure |= std::uint64_t{known[h]} << (j + 8 * h);
      inside |= std::uint64_t{in[h]} << (j + 8 * h);
      for (std::size_t bit = 0; bit < bits.size(); ++bit)
        bits[bit] |= std::uint64_t{_mm512_test_epi64_mask(node.words[h], _mm512_set1_epi64(1LL << bit))} << (j + 8 * h);
    }
  }
  ByKey by_key{_pdep_u64(sure, which), _pdep_u64(sure & ~inside, which), {}};
  for (std::size_t bit = 0; bit < bits.size(); ++bit) by_key.bits[bit] = _pdep_u64(bits[bit], which);
  write_parts(t, by_key, part);
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

// Which of the unsure particles lie in the box of the leaf that was found for them. Rounded coordinates can't tell that
// of those on the box's faces.
std::uint64_t in_own_boxes(const Tables& t, const Axes& x, const FoundLeaves& found) {
  std::uint64_t in_box = 0;
  for (std::uint64_t still = found.unsure; still != 0; still &= still - 1) {
    const auto k = at(std::countr_zero(still));
    const std::size_t leaf = found.leaf(k);
    bool in = true;
    for (std::size_t a = 0; a < x.size(); ++a) in &= (x[a][k] >= t.sure_lo[a][leaf]) & (x[a][k] <= t.sure_hi[a][leaf]);
    in_box |= std::uint64_t{in ? 1U : 0U} << k;
  }
  return in_box;
}

}  // namespace

std::uint64_t find_leaves_by_key(const GuessTables& tables, const Axes& x, const particles::Id* id, std::int32_t* part,
                                 FoundLeaves& found) {
  if (tables.tied_faces) found.unsure &= ~in_own_boxes(tables, x, found);
  if (found.unsure == 0) return 0;
  const ByKey by_key = find_keys(tables, x, id, part, found.unsure);
  found.boundary |= found.unsure & ~by_key.interior;
  for (std::size_t bit = 0; bit < found.bits.size(); ++bit)
    found.bits[bit] = (found.bits[bit] & ~by_key.interior) | (by_key.bits[bit] & by_key.interior);
  return by_key.beyond;
}

}  // namespace rcb::partition
