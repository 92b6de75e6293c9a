// The cuts of the first three levels are all compared with each particle, four particles at a time, which is cheaper
// than looking up the one cut of each level that matters; further down each particle follows its own path.
#include "common/cuts/classifier.hpp"

#include <algorithm>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "common/base/cpu.hpp"
#include "common/base/index.hpp"

namespace rcb::cuts {

Classifier::Classifier(const CutTree& tree) : tree_(tree), inner_(tree.parts - 1), steps_(at(inner_) + at(tree.parts)) {
  for (std::int32_t p = inner_; p < inner_ + tree.parts; ++p) steps_[at(p)] = {geometry::Box::kInfinity, 0, {p, p}};
  root_ = label(tree.root());
  add(tree.root(), 0);
  std::array<std::int32_t, 15> node{root_};
  for (std::size_t k = 0; k < top_.value.size(); ++k) {
    const Step& step = steps_[at(node[k])];
    top_.value[k] = step.value;
    top_.at[k] = step.at;
    node[2 * k + 1] = step.child[0];
    node[2 * k + 2] = step.child[1];
  }
  std::copy(node.end() - 8, node.end(), top_.label.begin());
}

void Classifier::add(const NodeRange& range, int depth) {
  depth_ = std::max(depth_, depth);
  if (range.leaf()) return;
  const Cut& cut = tree_.cuts[at(range.node)];
  steps_[at(range.node)] = {cut.right_empty ? geometry::Box::kInfinity : cut.key.at[0],
                            static_cast<std::int32_t>(at(cut.axes[0]) * Batch::kMost),
                            {label(range.left()), label(range.right())}};
  add(range.left(), depth + 1);
  add(range.right(), depth + 1);
}

void Classifier::descend(const Batch& batch, std::size_t count, std::int32_t* out, Ties& tied) const {
  int level = 0;
#if defined(__x86_64__)
  if (has_avx2()) {
    // A tail of fewer than four particles takes these levels step by step.
    const std::size_t whole = count / 4 * 4;
    descend_top(top_, batch, whole, out, tied);
    std::fill(out + whole, out + count, root_);
    for (; level < Top::kLevels; ++level) step(batch, whole, count, out, tied);
  }
#endif
  if (level == 0) std::fill(out, out + count, root_);
  for (; level < depth_; ++level) step(batch, 0, count, out, tied);
}

void Classifier::step(const Batch& batch, std::size_t from, std::size_t end, std::int32_t* out, Ties& tied) const {
  for (std::size_t i = from; i < end; ++i) {
    const Step& step = steps_[at(out[i])];
    const double x = batch.x[at(step.at) + i];
    tied[i] |= static_cast<std::uint8_t>(x == step.value);
    out[i] = step.child[static_cast<std::size_t>(x > step.value)];
  }
}

#if defined(__x86_64__)
[[gnu::target("avx2")]] void Classifier::descend_top(const Top& top, const Batch& batch, std::size_t end,
                                                     std::int32_t* out, Ties& tied) {
  const __m256i labels = _mm256_load_si256(reinterpret_cast<const __m256i*>(top.label.data()));
  const __m256i evens = _mm256_setr_epi32(0, 2, 4, 6, 0, 2, 4, 6);
  for (std::size_t i = 0; i < end; i += 4) {
    __m256d right[7];
    __m256d on = _mm256_setzero_pd();
    for (std::size_t k = 0; k < top.value.size(); ++k) {
      const __m256d x = _mm256_loadu_pd(batch.x.data() + top.at[k] + i);
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
      for (std::size_t k = 0; k < 4; ++k) tied[i + k] |= static_cast<std::uint8_t>(mask >> k & 1);
  }
}
#endif

void CutTree::classify(const particles::ParticleView& particles, std::span<std::int32_t> out) const {
  RCB_CHECK(particles.dims == dims && out.size() == particles.count,
            "a part for each particle of the tree's dimensions");
  // A classifier copies the whole tree first, which few particles in many parts don't pay back.
  if (particles.count < static_cast<std::size_t>(parts)) {
    for (std::size_t i = 0; i < particles.count; ++i) out[i] = part_of(particles.point(i), particles.id[i]);
    return;
  }
  const Classifier classifier(*this);
  Batch batch;
  for (std::size_t begin = 0; begin < particles.count; begin += Batch::kMost) {
    const std::size_t count = std::min(Batch::kMost, particles.count - begin);
    for (std::size_t a = 0; a < at(dims); ++a) std::copy_n(particles.position[a] + begin, count, batch.axis(a));
    classifier.classify(batch, count, out.data() + begin, [&](std::size_t i) { return particles.id[begin + i]; });
  }
}

}  // namespace rcb::cuts
