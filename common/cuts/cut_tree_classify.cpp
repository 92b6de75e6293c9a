// Classifies many particles at once. The cuts of the first three levels are all compared with each particle, four
// particles at a time, which is cheaper than looking up the one cut of each level that matters; further down each
// particle follows its own path.
#include <algorithm>
#include <array>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "common/base/cpu.hpp"
#include "common/base/index.hpp"
#include "common/cuts/cut_tree.hpp"

namespace rcb::cuts {
namespace {

// A node as the descent reads it: steps_[n] is inner node n, steps_[inner nodes + p] is part p. A part is its own
// child, so that all particles take the same number of steps and no branch depends on their paths.
struct Step {
  double value;     // the key's first coordinate; infinite where nothing goes right
  const double* x;  // the particles' coordinates on that axis
  std::array<std::int32_t, 2>
      child;  // left, right; chosen by index, since a branch would be mispredicted half the time
};

// The first levels as a heap: node k has the children 2k + 1 and 2k + 2.
struct Top {
  static constexpr int kLevels = 3;
  std::array<double, 7> value;
  std::array<const double*, 7> x;
  alignas(32) std::array<std::int32_t, 8> label;  // of the eight nodes below

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

// Particles that descend together, level by level, so that their dependent loads overlap.
constexpr std::size_t kBatch = 512;
using Ties = std::array<std::uint8_t, kBatch>;  // 1: the particle lies on the plane of a cut

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

  // out: the labels of the leaves that particles [begin, end) reach.
  void run(std::size_t begin, std::size_t end, std::int32_t* out, Ties& tied) const {
    int level = 0;
#if defined(__x86_64__)
    if (has_avx2()) {
      // A tail of fewer than four particles takes these levels step by step.
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
        on = _mm256_or_pd(on, _mm256_cmp_pd(x, value, _CMP_EQ_OQ));  // may be off its path; classify() checks
      }
      const __m256d second = _mm256_blendv_pd(right[1], right[2], right[0]);
      const __m256d third = _mm256_blendv_pd(_mm256_blendv_pd(right[3], right[4], second),
                                             _mm256_blendv_pd(right[5], right[6], second), right[0]);
      // The three decisions as a number, 0 to 7.
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
  RCB_CHECK(particles.dims == dims && out.size() == particles.count,
            "a part for each particle of the tree's dimensions");
  // A descent copies the whole tree first, which few particles in many parts don't pay back.
  if (particles.count < static_cast<std::size_t>(parts)) {
    for (std::size_t i = 0; i < particles.count; ++i) out[i] = part_of(particles.point(i), particles.id[i]);
    return;
  }
  const Descent descent(*this, particles);
  for (std::size_t begin = 0; begin < particles.count; begin += kBatch) {
    const std::size_t end = std::min(begin + kBatch, particles.count);
    Ties tied{};
    descent.run(begin, end, out.data(), tied);
    // On a cut's plane the tie-break (the other coordinates, then the id) decides: part_of() compares whole keys.
    for (std::size_t i = begin; i < end; ++i)
      out[i] = tied[i - begin] != 0 ? part_of(particles.point(i), particles.id[i]) : descent.part(out[i]);
  }
}

}  // namespace rcb::cuts
