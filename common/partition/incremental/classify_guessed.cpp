// Most particles lie in the box of the sampled particles of their part. Coordinates rounded to float show that:
// rounding keeps the order, so what is strictly between two rounded bounds lies between the bounds. Only the others are
// looked at one by one.
#include "common/partition/incremental/classify_guessed.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "common/base/cpu.hpp"
#include "common/base/index.hpp"

namespace rcb::partition {
namespace {

using particles::kBlock;
constexpr std::size_t kLeaves = kGuessLeaves;
// Particles that are prefetched ahead: the branches of a block's boundary particles depend on data, and a mispredicted
// one would otherwise wait for memory.
constexpr std::size_t kAhead = 1024;
constexpr std::int64_t kLeast = std::numeric_limits<std::int64_t>::min();
constexpr std::int64_t kMost = std::numeric_limits<std::int64_t>::max();
using Floats = std::array<float, kLeaves>;
using Integers = std::array<std::int32_t, kLeaves>;
using Axes = std::array<const double*, geometry::kDimsMax>;

// The guess as tables. On each level node k has the children next[k], and next[k] + 1 if it is cut; what ends above the
// last level is its own child.
struct alignas(64) Tables {
  Integers first{};  // of each part so far: its node on the first level
  std::array<Integers, kGuessLevels> next{};
  std::array<Floats, kGuessLevels> cut;  // infinite where nothing goes right
  std::array<Integers, kGuessLevels> axis;
  std::array<Floats, geometry::kDimsMax> lo;  // by axis and leaf: of its box
  std::array<Floats, geometry::kDimsMax> hi;
  std::array<Floats, geometry::kDimsMax> inner_lo;  // of its inner region
  std::array<Floats, geometry::kDimsMax> inner_hi;
  Integers part{};  // of each leaf
  // Behind the tables, which are aligned.
  std::array<double, geometry::kDimsMax> origin{};
  std::array<double, geometry::kDimsMax> scale{1, 1, 1};

  float rounded(std::size_t a, double x) const { return static_cast<float>((x - origin[a]) * scale[a]); }
};

// A key as integers of the same order, the first word last.
using KeyLanes = std::array<std::int64_t, geometry::kDimsMax + 1>;

// One node of the guess, for whole keys. What lies neither before `least` nor behind `most` is a boundary particle.
struct alignas(32) Step {
  KeyLanes least{};
  KeyLanes most{};
  std::array<std::int32_t, 8> order{};  // the words as halves of {x, y, z, id}
  std::int32_t next = 0;                // as in Tables
};

KeyLanes lanes_of(const Key& key) {
  KeyLanes lanes{key.id};
  for (std::size_t w = 0; w < key.at.size(); ++w)
    lanes[3 - w] = static_cast<std::int64_t>(geometry::order_bits(key.at[w]) ^ (std::uint64_t{1} << 63U));
  return lanes;
}

class GuessedPass {
 public:
  GuessedPass(const particles::ParticleView& particles, const Guess& guess, std::span<const NodeRange> roots,
              std::span<std::int32_t> part, std::size_t boundary_max, OwnInterior& out)
      : particles_(particles), part_(part), boundary_max_(boundary_max), out_(out) {
    for (auto& row : tables_.cut) row.fill(std::numeric_limits<float>::infinity());
    for (auto& row : tables_.axis) row.fill(0);
    for (auto& row : tables_.lo) row.fill(-std::numeric_limits<float>::infinity());
    for (auto& row : tables_.hi) row.fill(std::numeric_limits<float>::infinity());
    tables_.inner_lo = tables_.lo;
    tables_.inner_hi = tables_.hi;
    geometry::Box all;
    for (const geometry::Box& box : guess.seen) all.extend(box);
    for (std::size_t a = 0; a < axes() && !all.empty(particles.dims); ++a) {
      // Floats are densest at 0.
      tables_.origin[a] = std::clamp(0.0, all.lo[a], all.hi[a]);
      const double most =
          std::max(all.hi[a] * 0.5 - tables_.origin[a] * 0.5, tables_.origin[a] * 0.5 - all.lo[a] * 0.5);
      const double scale = std::isnormal(most) ? std::ldexp(1.0, -std::ilogb(most)) : 1.0;
      if (std::isnormal(scale)) tables_.scale[a] = scale;
    }
    add(guess, roots);
  }

  void run() {
    Axes x = particles_.position;
    for (std::size_t a = axes(); a < x.size(); ++a) x[a] = x[0];
    std::size_t begin = 0;
    for (; begin < particles_.count && listed_ <= boundary_max_; begin += kBlock) {
      const std::size_t count = std::min(kBlock, particles_.count - begin);
      make_room(listed_ + kBlock);
      const Axes own{x[0] + begin, x[1] + begin, x[2] + begin};
      Found found = find(own, part_.data() + begin, count);
      for (std::size_t leaf = 0; leaf < leaves_; ++leaf) {
        std::uint64_t mask = count < kBlock ? (std::uint64_t{1} << count) - 1 : ~std::uint64_t{0};
        for (std::size_t bit = 0; bit < found.bits.size(); ++bit)
          mask &= (leaf >> bit & 1U) != 0 ? found.bits[bit] : ~found.bits[bit];
        counts_[leaf] += at(std::popcount(mask));
      }
      std::array<std::int32_t, kBlock> by_key;
      find_by_key(own, begin, found.unsure, by_key);
      for (; found.unsure != 0; found.unsure &= found.unsure - 1) {
        const auto k = at(std::countr_zero(found.unsure));
        found.boundary |= (settle(begin + k, found.leaf(k), by_key[k]) ? 0ULL : 1ULL) << k;
      }
      for (; found.boundary != 0; found.boundary &= found.boundary - 1) {
        const auto k = at(std::countr_zero(found.boundary));
        out_.slot[listed_] = begin + k;
        out_.part[listed_] = part_[begin + k];
        for (std::size_t a = 0; a < axes(); ++a) out_.boundary.position[a][listed_] = own[a][k];
        ++listed_;
      }
    }
    // Where it stopped, the others get some part all the same.
    for (std::size_t i = begin; i < particles_.count && !several_; ++i) part_[i] = 0;
    resize(listed_);
    for (std::size_t leaf = 0; leaf < leaves_; ++leaf) {
      out_.boxes[at(tables_.part[leaf])] = box_[leaf];
      out_.counts[at(tables_.part[leaf])] = counts_[leaf];
    }
  }

 private:
  std::size_t axes() const { return at(particles_.dims); }

  void add(const Guess& guess, std::span<const NodeRange> roots) {
    struct Node {
      NodeRange range;
      bool ends;
      bool fixed;  // in no root
    };
    const auto below = [&guess](const NodeRange& range) {
      return Node{range, range.leaf() || guess.ends[at(range.node)] != 0, false};
    };
    several_ = roots.size() > 1 || roots[0].parts() < guess.tree.parts;
    std::vector<Node> level;
    int part = 0;
    const auto add_fixed = [&](int until) {
      for (; part < until; ++part) {
        tables_.first[at(part)] = static_cast<std::int32_t>(level.size());
        level.push_back({{0, part, part + 1}, true, true});
      }
    };
    for (const NodeRange& root : roots) {
      if (several_) add_fixed(root.first);
      for (; several_ && part < root.last; ++part) tables_.first[at(part)] = static_cast<std::int32_t>(level.size());
      level.push_back(below(root));
    }
    if (several_) add_fixed(guess.tree.parts);
    for (std::size_t l = 0; l < at(kGuessLevels); ++l) {
      std::vector<Node> next;
      for (std::size_t k = 0; k < level.size(); ++k) {
        tables_.next[l][k] = static_cast<std::int32_t>(next.size());
        Step& step = steps_[l][k];
        step.next = tables_.next[l][k];
        step.least.fill(kMost);
        step.most.fill(kMost);
        if (level[k].ends) {
          next.push_back(level[k]);
          continue;
        }
        const NodeRange& range = level[k].range;
        const KeyBracket& bracket = guess.brackets[at(range.node)];
        // So that what lies on the plane of `least` or of `most` is where the inner region ends at that plane.
        tables_.cut[l][k] = tables_.rounded(at(bracket.axes[0]), bracket.least.at[0]);
        tables_.axis[l][k] = bracket.axes[0];
        step.least = lanes_of(bracket.least);
        step.most = lanes_of(bracket.most);
        if (!bracket.whole) std::fill_n(step.least.begin(), 3, kLeast), std::fill_n(step.most.begin(), 3, kMost);
        for (std::size_t w = 0; w < bracket.axes.size(); ++w)
          for (std::size_t half = 0; half < 2; ++half)
            step.order[2 * (3 - w) + half] = 2 * bracket.axes[w] + static_cast<std::int32_t>(half);
        step.order[0] = 6;
        step.order[1] = 7;
        next.push_back(below(range.left()));
        next.push_back(below(range.right()));
      }
      level = std::move(next);
      CHECK(level.size() <= kLeaves, "a guess has few leaves");
    }
    leaves_ = level.size();
    for (std::size_t k = 0; k < leaves_; ++k) {
      const auto first = at(level[k].range.first);
      tables_.part[k] = level[k].range.first;
      if (level[k].fixed) continue;  // every particle is in its box
      box_[k] = guess.seen[first];
      for (std::size_t a = 0; a < axes(); ++a) {
        tables_.inner_lo[a][k] = tables_.rounded(a, guess.inner[first].lo[a]);
        tables_.inner_hi[a][k] = tables_.rounded(a, guess.inner[first].hi[a]);
        show(k, a);
      }
    }
  }

  // Takes a leaf's box over into the tables. A bound itself counts as inside where rounding tells it from its
  // neighbour; what isn't strictly in the inner region never does, since there the whole key may decide.
  void show(std::size_t leaf, std::size_t a) {
    constexpr float kInfinity = std::numeric_limits<float>::infinity();
    const double lo = box_[leaf].lo[a];
    const double hi = box_[leaf].hi[a];
    float least = tables_.rounded(a, lo);
    float most = tables_.rounded(a, hi);
    if (tables_.rounded(a, std::nextafter(lo, -geometry::Box::kInfinity)) < least)
      least = std::nextafter(least, -kInfinity);
    if (tables_.rounded(a, std::nextafter(hi, geometry::Box::kInfinity)) > most) most = std::nextafter(most, kInfinity);
    const bool none = lo > hi;
    tables_.lo[a][leaf] = none ? kInfinity : std::max(least, tables_.inner_lo[a][leaf]);
    tables_.hi[a][leaf] = none ? -kInfinity : std::min(most, tables_.inner_hi[a][leaf]);
  }

  void resize(std::size_t count) {
    out_.slot.resize(count);
    out_.part.resize(count);
    for (std::size_t a = 0; a < axes(); ++a) out_.boundary.position[a].resize(count);
  }
  void make_room(std::size_t count) {
    if (count > out_.slot.size()) resize(std::max(count, 2 * out_.slot.size()));
  }

  // True if a particle is interior; then its leaf's box grows to hold it. leaf: the one that its rounded coordinates
  // gave it; found: the one of its key, or -1.
  bool settle(std::size_t i, std::size_t leaf, std::int32_t found) {
    if (found < 0) return false;
    if (at(found) != leaf) {
      --counts_[leaf];
      leaf = at(found);
      ++counts_[leaf];
      part_[i] = tables_.part[leaf];
    }
    geometry::Box& box = box_[leaf];
    for (std::size_t a = 0; a < axes(); ++a) {
      const double x = particles_.position[a][i];
      if (x >= box.lo[a] && x <= box.hi[a]) continue;
      box.lo[a] = std::min(box.lo[a], x);
      box.hi[a] = std::max(box.hi[a], x);
      show(leaf, a);
    }
    return true;
  }

  // The particles of a block, one bit each, that are surely not in their leaf's inner region, and those that are
  // neither surely there nor surely in its box.
  struct Found {
    std::uint64_t boundary = 0;
    std::uint64_t unsure = 0;
    std::array<std::uint64_t, 3> bits{};  // of the number of each particle's leaf

    std::size_t leaf(std::size_t k) const {
      return (bits[0] >> k & 1U) | (bits[1] >> k & 1U) << 1U | (bits[2] >> k & 1U) << 2U;
    }
  };

  // Sets the parts of a block.
  Found find(const Axes& x, std::int32_t* part, std::size_t count) const {
    Found found;
    std::size_t i = 0;
#if defined(__x86_64__)
    if (has_avx2()) i = several_ ? find_eights<true>(x, part, count, found) : find_eights<false>(x, part, count, found);
#endif
    for (; i < count; ++i) {
      const std::array<float, 3> own{tables_.rounded(0, x[0][i]), tables_.rounded(1, x[1][i]),
                                     tables_.rounded(2, x[2][i])};
      std::size_t leaf = several_ ? at(tables_.first[at(part[i])]) : 0;
      for (std::size_t level = 0; level < at(kGuessLevels); ++level)
        leaf =
            at(tables_.next[level][leaf]) + (own[at(tables_.axis[level][leaf])] > tables_.cut[level][leaf] ? 1U : 0U);
      for (std::size_t bit = 0; bit < found.bits.size(); ++bit)
        found.bits[bit] |= (leaf >> bit & std::uint64_t{1}) << i;
      bool in = true;
      bool out = false;
      for (std::size_t a = 0; a < own.size(); ++a) {
        in &= own[a] > tables_.lo[a][leaf] && own[a] < tables_.hi[a][leaf];
        out |= own[a] < tables_.inner_lo[a][leaf] || own[a] > tables_.inner_hi[a][leaf];
      }
      part[i] = tables_.part[leaf];
      found.boundary |= (out ? 1ULL : 0ULL) << i;
      found.unsure |= (in || out ? 0ULL : 1ULL) << i;
    }
    return found;
  }

  // The leaf of each of these particles of a block by its key, or -1 if it is a boundary particle.
  void find_by_key(const Axes& x, std::size_t begin, std::uint64_t which,
                   std::array<std::int32_t, kBlock>& leaf) const {
#if defined(__x86_64__)
    if (has_avx2()) return find_by_key_in_lanes(x, begin, which, leaf);
#endif
    for (; which != 0; which &= which - 1) {
      const auto k = at(std::countr_zero(which));
      KeyLanes own{0, 0, 0, particles_.id[begin + k]};
      for (std::size_t a = 0; a < axes(); ++a)
        own[a] = static_cast<std::int64_t>(geometry::order_bits(x[a][k]) ^ (std::uint64_t{1} << 63U));
      const auto sign = [&own](const Step& step, const KeyLanes& key) {
        for (std::size_t w = 4; w-- > 0;)
          if (const std::int64_t word = own[at(step.order[2 * w]) / 2]; word != key[w]) return word < key[w] ? -1 : 1;
        return 0;
      };
      std::int32_t node = first_of(begin + k);
      for (std::size_t level = 0; level < steps_.size() && node >= 0; ++level) {
        const Step& step = steps_[level][at(node)];
        const bool right = sign(step, step.most) > 0;
        node = right || sign(step, step.least) < 0 ? step.next + (right ? 1 : 0) : -1;
      }
      leaf[k] = node;
    }
  }
  std::int32_t first_of(std::size_t i) const { return several_ ? tables_.first[at(part_[i])] : 0; }

#if defined(__x86_64__)
  [[gnu::target("avx2"), gnu::always_inline]] static inline __m256i lanes(const KeyLanes& key) {
    return _mm256_load_si256(reinterpret_cast<const __m256i*>(&key));
  }
  // Which words of a are greater than those of b; the first word is the highest bit.
  [[gnu::target("avx2"), gnu::always_inline]] static inline int greater(__m256i a, __m256i b) {
    return _mm256_movemask_pd(_mm256_castsi256_pd(_mm256_cmpgt_epi64(a, b)));
  }
  // All words of a key are compared at once, and the first that differs decides. Without branches: on planes that hold
  // many particles they would be mispredicted.
  [[gnu::target("avx2")]] void find_by_key_in_lanes(const Axes& x, std::size_t begin, std::uint64_t which,
                                                    std::array<std::int32_t, kBlock>& leaf) const {
    const __m256i none = _mm256_setzero_si256();
    const auto mask = [this](std::size_t a) { return a < axes() ? -1LL : 0LL; };
    const __m256i used = _mm256_set_epi64x(0, mask(2), mask(1), mask(0));
    for (; which != 0; which &= which - 1) {
      const auto k = at(std::countr_zero(which));
      const __m256d point = _mm256_add_pd(_mm256_set_pd(0, x[2][k], x[1][k], x[0][k]), _mm256_setzero_pd());
      __m256i own = _mm256_and_si256(_mm256_castpd_si256(point), used);
      const __m256i turn = _mm256_srli_epi64(_mm256_cmpgt_epi64(none, own), 1);
      own = _mm256_insert_epi64(_mm256_xor_si256(own, turn), particles_.id[begin + k], 3);
      std::int32_t node = first_of(begin + k);
      bool sure = true;
      for (const auto& level : steps_) {
        const Step& step = level[at(node)];
        const __m256i order = _mm256_load_si256(reinterpret_cast<const __m256i*>(step.order.data()));
        const __m256i key = _mm256_permutevar8x32_epi32(own, order);
        const __m256i least = lanes(step.least);
        const __m256i most = lanes(step.most);
        const bool left = greater(least, key) > greater(key, least);
        const bool right = greater(key, most) > greater(most, key);
        sure &= left | right;
        node = step.next + static_cast<std::int32_t>(right);
      }
      leaf[k] = sure ? node : -1;
    }
  }
  [[gnu::target("avx2"), gnu::always_inline]] static inline __m256 as_floats(const double* x, double origin,
                                                                             double scale) {
    const __m256d o = _mm256_set1_pd(origin);
    const __m256d s = _mm256_set1_pd(scale);
    return _mm256_set_m128(_mm256_cvtpd_ps(_mm256_mul_pd(_mm256_sub_pd(_mm256_loadu_pd(x + 4), o), s)),
                           _mm256_cvtpd_ps(_mm256_mul_pd(_mm256_sub_pd(_mm256_loadu_pd(x), o), s)));
  }
  [[gnu::target("avx2"), gnu::always_inline]] static inline __m256 in_table(const Floats& table, __m256i index) {
    return _mm256_permutevar8x32_ps(_mm256_load_ps(table.data()), index);
  }
  [[gnu::target("avx2"), gnu::always_inline]] static inline __m256i in_table(const Integers& table, __m256i index) {
    return _mm256_permutevar8x32_epi32(_mm256_load_si256(reinterpret_cast<const __m256i*>(table.data())), index);
  }
  // Returns how many particles it took.
  template <bool kSeveral>
  [[gnu::target("avx2")]] std::size_t find_eights(const Axes& x, std::int32_t* part, std::size_t count,
                                                  Found& found) const {
    const Tables& t = tables_;
    std::size_t i = 0;
    for (; i + kLeaves <= count; i += kLeaves) {
      for (const double* axis : x) _mm_prefetch(axis + i + kAhead, _MM_HINT_T0);
      const __m256 own[3] = {as_floats(x[0] + i, t.origin[0], t.scale[0]), as_floats(x[1] + i, t.origin[1], t.scale[1]),
                             as_floats(x[2] + i, t.origin[2], t.scale[2])};
      __m256i leaf = _mm256_setzero_si256();
      if constexpr (kSeveral) leaf = in_table(t.first, _mm256_loadu_si256(reinterpret_cast<const __m256i*>(part + i)));
      for (std::size_t level = 0; level < at(kGuessLevels); ++level) {
        const __m256i axis = in_table(t.axis[level], leaf);
        // Bit 0 selects the second coordinate, bit 1 the third.
        const __m256 low = _mm256_blendv_ps(own[0], own[1], _mm256_castsi256_ps(_mm256_slli_epi32(axis, 31)));
        const __m256 on = _mm256_blendv_ps(low, own[2], _mm256_castsi256_ps(_mm256_slli_epi32(axis, 30)));
        const __m256 right = _mm256_cmp_ps(on, in_table(t.cut[level], leaf), _CMP_GT_OQ);
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
      __m256 out = _mm256_setzero_ps();
      for (std::size_t a = 0; a < at(geometry::kDimsMax); ++a) {
        out = _mm256_or_ps(out, _mm256_cmp_ps(own[a], in_table(t.inner_lo[a], leaf), _CMP_LT_OQ));
        out = _mm256_or_ps(out, _mm256_cmp_ps(own[a], in_table(t.inner_hi[a], leaf), _CMP_GT_OQ));
      }
      const auto boundary = static_cast<unsigned>(_mm256_movemask_ps(out));
      found.boundary |= std::uint64_t{boundary} << i;
      found.unsure |= std::uint64_t{beyond & ~boundary} << i;
    }
    return i;
  }
#endif

  const particles::ParticleView& particles_;
  std::span<std::int32_t> part_;
  std::size_t boundary_max_;
  OwnInterior& out_;
  std::size_t listed_ = 0;  // boundary particles so far
  Tables tables_;
  std::array<std::array<Step, kLeaves>, kGuessLevels> steps_;
  bool several_ = false;  // roots, or parts in no root
  std::size_t leaves_ = 0;
  std::array<std::uint64_t, kLeaves> counts_{};
  std::array<geometry::Box, kLeaves> box_;  // of the interior particles so far, attained by some of any rank
};

}  // namespace

OwnInterior classify_guessed(const particles::ParticleView& particles, const Guess& guess,
                             std::span<const NodeRange> roots, std::span<std::int32_t> part, std::size_t boundary_max) {
  OwnInterior out;
  out.reserve(particles, particles.count / 8);
  out.boxes.resize(guess.inner.size());
  out.counts.resize(guess.inner.size());
  GuessedPass(particles, guess, roots, part, boundary_max, out).run();
  out.finish(particles, boundary_max);
  return out;
}

}  // namespace rcb::partition
