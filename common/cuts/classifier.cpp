#include "common/cuts/classifier.hpp"

#include <algorithm>

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
  // The first levels all at once; further down each position follows its own path, and a few last ones do from the
  // root.
  const std::size_t whole = kernels().descend(top_, batch.x.data(), count, out, tied.data());
  std::fill(out + whole, out + count, root_);
  for (int level = 0; level < depth_; ++level) step(batch, level < TopCuts::kLevels ? whole : 0, count, out, tied);
}

void Classifier::step(const Batch& batch, std::size_t from, std::size_t end, std::int32_t* out, Ties& tied) const {
  for (std::size_t i = from; i < end; ++i) {
    const Step& step = steps_[at(out[i])];
    const double x = batch.x[at(step.at) + i];
    tied[i] |= static_cast<std::uint8_t>(x == step.value);
    out[i] = step.child[static_cast<std::size_t>(x > step.value)];
  }
}

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
