// The parts of many particles. The cuts of the first levels are all compared with each particle, four particles at a
// time, which costs less than to look up the one cut that counts; further down each particle follows its own path.
#include <algorithm>
#include <array>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "common/partition/cut_tree.hpp"

namespace rcb::partition {
namespace {

std::size_t at(int index) { return static_cast<std::size_t>(index); }

// What a descent reads of a node: an inner node at its number, part p at inner nodes + p. A part leads to itself, so
// that all particles take the same number of steps and no branch depends on where one goes.
struct Step {
  double value;     // on the cut axis; infinite where nothing goes right
  const double* x;  // the particles' coordinates on that axis
  std::array<std::int32_t, 2>
      child;  // left and right; picked by index, since a branch would be guessed wrong half the time
};

// The first levels: node k leads to 2k + 1 and 2k + 2.
struct Top {
  static constexpr int kLevels = 3;
  std::array<double, 7> value;
  std::array<const double*, 7> x;
  alignas(32) std::array<std::int32_t, 8> label;  // of the nodes below

  Top() = default;
  Top(std::span<const Step> steps, std::int32_t root) {
    std::array<std::int32_t, 15> node{root};
    for (std::size_t k = 0; k < value.size(); ++k) {
      const Step& step = steps[at(node[k])];
      value[k] = step.value;
      x[k] = step.x;
      node[2 * k + 1] = step.child[0];
      node[2 * k + 2] = step.child[1];
    }
    std::copy(node.end() - 8, node.end(), label.begin());
  }
};

// Particles that step together: their chains of loads overlap.
constexpr std::size_t kBlock = 512;
using Ties = std::array<std::uint8_t, kBlock>;  // 1: on a cut's plane

class Descent {
 public:
  Descent(const CutTree& tree, const particles::ParticleView& particles)
      : inner_(tree.parts - 1), steps_(at(inner_) + at(tree.parts)) {
    for (std::int32_t p = inner_; p < inner_ + tree.parts; ++p)
      steps_[at(p)] = {geometry::Box::kInfinity, particles.position[0], {p, p}};
    root_ = label(tree.root());
    add(tree, particles, tree.root(), 0);
    top_ = Top(steps_, root_);
  }

  // out: the labels of particles [begin, end) at the end of their paths.
  void run(std::size_t begin, std::size_t end, std::int32_t* out, Ties& tied) const {
    int level = 0;
#if defined(__x86_64__)
    static const bool avx2 = __builtin_cpu_supports("avx2") != 0;
    if (avx2) {
      // A tail of fewer than four starts at the root too.
      const std::size_t whole = begin + (end - begin) / 4 * 4;
      descend_top(top_, begin, whole, out, tied);
      std::fill(out + whole, out + end, root_);
      for (; level < Top::kLevels; ++level) step(whole, end, begin, out, tied);
    }
#endif
    if (level == 0) std::fill(out + begin, out + end, root_);
    for (; level < depth_; ++level) step(begin, end, begin, out, tied);
  }
  std::int32_t part(std::int32_t label) const { return label - inner_; }

 private:
  std::int32_t label(const NodeRange& range) const { return range.leaf() ? inner_ + range.first : range.node; }

  void add(const CutTree& tree, const particles::ParticleView& particles, const NodeRange& range, int depth) {
    depth_ = std::max(depth_, depth);
    if (range.leaf()) return;
    const Cut& cut = tree.cuts[at(range.node)];
    steps_[at(range.node)] = {cut.right_empty ? geometry::Box::kInfinity : cut.key.at[0],
                              particles.position[at(cut.axes[0])],
                              {label(range.left()), label(range.right())}};
    add(tree, particles, range.left(), depth + 1);
    add(tree, particles, range.right(), depth + 1);
  }

  void step(std::size_t from, std::size_t end, std::size_t begin, std::int32_t* out, Ties& tied) const {
    for (std::size_t i = from; i < end; ++i) {
      const Step& step = steps_[at(out[i])];
      const double x = step.x[i];
      tied[i - begin] |= static_cast<std::uint8_t>(x == step.value);
      out[i] = step.child[static_cast<std::size_t>(x > step.value)];
    }
  }

#if defined(__x86_64__)
  [[gnu::target("avx2")]] static void descend_top(const Top& top, std::size_t begin, std::size_t end, std::int32_t* out,
                                                  Ties& tied) {
    const __m256i labels = _mm256_load_si256(reinterpret_cast<const __m256i*>(top.label.data()));
    const __m256i evens = _mm256_setr_epi32(0, 2, 4, 6, 0, 2, 4, 6);
    for (std::size_t i = begin; i < end; i += 4) {
      __m256d right[7];
      __m256d on = _mm256_setzero_pd();
      for (std::size_t k = 0; k < top.value.size(); ++k) {
        const __m256d x = _mm256_loadu_pd(top.x[k] + i);
        const __m256d value = _mm256_set1_pd(top.value[k]);
        right[k] = _mm256_cmp_pd(x, value, _CMP_GT_OQ);
        on = _mm256_or_pd(on, _mm256_cmp_pd(x, value, _CMP_EQ_OQ));  // any cut's plane will do: it is asked again
      }
      const __m256d second = _mm256_blendv_pd(right[1], right[2], right[0]);
      const __m256d third = _mm256_blendv_pd(_mm256_blendv_pd(right[3], right[4], second),
                                             _mm256_blendv_pd(right[5], right[6], second), right[0]);
      // Their bits as a number, 0 to 7.
      const __m256i below =
          _mm256_or_si256(_mm256_and_si256(_mm256_castpd_si256(right[0]), _mm256_set1_epi64x(4)),
                          _mm256_or_si256(_mm256_and_si256(_mm256_castpd_si256(second), _mm256_set1_epi64x(2)),
                                          _mm256_and_si256(_mm256_castpd_si256(third), _mm256_set1_epi64x(1))));
      const __m256i found = _mm256_permutevar8x32_epi32(_mm256_permutevar8x32_epi32(labels, below), evens);
      _mm_storeu_si128(reinterpret_cast<__m128i*>(out + i), _mm256_castsi256_si128(found));
      if (const int mask = _mm256_movemask_pd(on); mask != 0)
        for (std::size_t k = 0; k < 4; ++k) tied[i - begin + k] |= static_cast<std::uint8_t>(mask >> k & 1);
    }
  }
#endif

  std::int32_t inner_;
  std::int32_t root_ = 0;
  int depth_ = 0;
  std::vector<Step> steps_;
  Top top_;
};

}  // namespace

void CutTree::classify(const particles::ParticleView& particles, std::span<std::int32_t> out) const {
  CHECK(particles.dims == dims && out.size() == particles.count, "a part for each particle of the tree's dimensions");
  const Descent descent(*this, particles);
  for (std::size_t begin = 0; begin < particles.count; begin += kBlock) {
    const std::size_t end = std::min(begin + kBlock, particles.count);
    Ties tied{};
    descent.run(begin, end, out.data(), tied);
    // On a cut's plane the rest of the key decides.
    for (std::size_t i = begin; i < end; ++i)
      out[i] = tied[i - begin] != 0 ? part_of(particles.point(i), particles.id[i]) : descent.part(out[i]);
  }
}

}  // namespace rcb::partition
