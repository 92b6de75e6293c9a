#include "common/partition/build_tree.hpp"

#include <algorithm>
#include <limits>

#include "common/partition/refine.hpp"
#include "common/partition/wide_sum.hpp"

namespace rcb::partition {
namespace {

constexpr std::uint64_t kIdMax = static_cast<std::uint64_t>(std::numeric_limits<Id>::max());

std::size_t at(int index) { return static_cast<std::size_t>(index); }

// Least and greatest of an array. Four of each at once, since one would wait for itself.
void measure(std::span<const double> values, double& lo, double& hi) {
  std::array<double, 4> least;
  std::array<double, 4> most;
  least.fill(lo);
  most.fill(hi);
  std::size_t i = 0;
  for (; i + 4 <= values.size(); i += 4)
    for (std::size_t k = 0; k < 4; ++k) {
      const double value = values[i + k];
      least[k] = value < least[k] ? value : least[k];
      most[k] = value > most[k] ? value : most[k];
    }
  for (; i < values.size(); ++i) {
    least[0] = std::min(least[0], values[i]);
    most[0] = std::max(most[0], values[i]);
  }
  lo = *std::ranges::min_element(least);
  hi = *std::ranges::max_element(most);
}

}  // namespace

TreeBuilder::TreeBuilder(Comm& comm, const particles::ParticleView& particles, const PartitionOptions& options,
                         int axes)
    : comm_(comm), particles_(particles), options_(options), axes_(axes), rule_(options, axes) {
  CutTree& tree = result_.tree;
  tree.dims = particles.dims;
  tree.method = options.method;
  tree.parts = options.parts;
  const auto& sizes = options.part_sizes;
  if (std::ranges::any_of(sizes, [&](double size) { return size != sizes[0]; })) tree.part_sizes = sizes;
  tree.cuts.resize(at(options.parts) - 1);
}

PartitionResult TreeBuilder::build() {
  result_.part.resize(particles_.count);
  std::fill(result_.part.begin(), result_.part.end(), 0);
  if (options_.parts == 1) return std::move(result_);
  measure_all();
  if (refinable()) {
    refine();
    return std::move(result_);
  }
  Selector selector(comm_, particles_, axes_, scale_ ? &*scale_ : nullptr);
  std::vector<SelectNode> asked;
  while (!level_.empty()) {
    asked.assign(level_.size(), SelectNode{});
    for (std::size_t n = 0; n < level_.size(); ++n) ask(level_[n], bounds_[n], asked[n]);
    selector.select(asked, result_.part.span());
    split(asked);
    label_all();
    level_.swap(next_);
  }
  for (std::int32_t& part : result_.part) part = -1 - part;
  result_.rounds += selector.rounds();
  result_.reductions += selector.reductions();
  return std::move(result_);
}

bool TreeBuilder::refinable() const {
  constexpr std::size_t kLocalMax = std::size_t{1} << 31U;
  constexpr std::uint64_t kPointsPerPart = 32;  // with a sparser sample the brackets are too wide to be worth a guess
  const std::uint64_t count = rule_.quota(0, options_.parts);
  return !scale_ && axes_ > 0 && local_count_max_ < kLocalMax &&
         count >= std::max<std::uint64_t>(options_.refinement.points_min, 1) &&
         (options_.refinement.sample > 0 ||
          balanced_sample(count, comm_.size()) / kPointsPerPart >= static_cast<std::uint64_t>(options_.parts));
}

void TreeBuilder::refine() {
  Refiner refiner(comm_, particles_, rule_, options_);
  refiner.run(bounds_[0], result_.tree, result_.part.span());
  result_.rounds += refiner.rounds();
  result_.reductions += refiner.reductions();
  result_.refined = refiner.counts();
}

// The root: number of particles, extents, weights.
void TreeBuilder::measure_all() {
  std::vector<std::uint64_t> least(2 * geometry::kDimsMax + 3, kNoImage);
  least[2 * geometry::kDimsMax] = ~std::uint64_t{particles_.count};
  for (int a = 0; a < axes_ && particles_.count > 0; ++a) {
    double lo = particles_.position[at(a)][0];
    double hi = lo;
    measure({particles_.position[at(a)], particles_.count}, lo, hi);
    least[at(a)] = geometry::image(lo);
    least[geometry::kDimsMax + at(a)] = ~geometry::image(hi);
  }
  if (axes_ > 0) std::ranges::copy(weight_images(particles_), least.end() - 2);
  comm_.all_min(least);
  std::uint64_t count = particles_.count;
  comm_.all_sum({&count, 1});
  result_.reductions += 2;
  bounds_.resize(1);
  std::copy_n(least.begin(), geometry::kDimsMax, bounds_[0].lo.begin());
  std::copy_n(least.begin() + geometry::kDimsMax, geometry::kDimsMax, bounds_[0].not_hi.begin());
  local_count_max_ = ~least[2 * geometry::kDimsMax];
  rule_.set_all(count, bounds_[0]);

  Node root{NodeRange{0, 0, options_.parts}, count, 0};
  if (const auto range = weight_range_of_images(std::span<const std::uint64_t>(least).last<2>())) {
    scale_.emplace(range->largest, count);
    for (std::size_t i = 0; i < particles_.count; ++i) root.weight += (*scale_)(particles_.weight[i]);
    all_sum_wide(comm_, {&root.weight, 1});
    ++result_.reductions;
  }
  level_.assign(1, root);
}

void TreeBuilder::ask(const Node& node, const Bounds& bounds, SelectNode& out) const {
  out.axes = rule_.axes_of(node.range, bounds);
  for (std::size_t w = 0; w < at(axes_); ++w) {
    const auto axis = static_cast<std::size_t>(out.axes[w]);
    out.lo[w] = bounds.lo[axis];
    out.hi[w] = ~bounds.not_hi[axis];
    out.empty = out.empty || bounds.lo[axis] == kNoImage;
  }
  out.lo[at(axes_)] = 0;
  out.hi[at(axes_)] = kIdMax;
  const auto [index, first, last] = node.range;
  const int middle = node.range.middle();
  if (scale_) {
    out.weight = node.weight;
    out.left_size = rule_.size(first, middle);
    out.size = rule_.size(first, last);
  } else {
    out.count = node.count;
    out.empty = node.count == 0;
    out.rank = rule_.quota(first, middle);
  }
}

void TreeBuilder::split(std::span<const SelectNode> answers) {
  next_.clear();
  branches_.resize(level_.size());
  for (std::size_t n = 0; n < level_.size(); ++n) {
    const Node& node = level_[n];
    const SelectNode& answer = answers[n];
    Cut& cut = result_.tree.cuts[at(node.range.node)];
    cut.axes = answer.axes;
    cut.right_empty = answer.right_empty;
    if (!cut.right_empty) {
      for (std::size_t w = 0; w < at(axes_); ++w) cut.key.at[w] = geometry::value_of_image(answer.key[w]);
      cut.key.id = static_cast<Id>(answer.key[at(axes_)]);
    }
    Node left{node.range.left(), answer.rank, answer.right_empty ? node.weight : answer.left_weight};
    Node right{node.range.right(), node.count - answer.rank, node.weight - left.weight};
    const auto label = [this](const Node& child) {
      if (child.range.leaf()) return -1 - child.range.first;
      next_.push_back(child);
      return static_cast<std::int32_t>(next_.size()) - 1;
    };
    Branch& branch = branches_[n];
    branch.at = cut.right_empty ? std::numeric_limits<double>::infinity() : cut.key.at[0];
    branch.x = axes_ > 0 ? particles_.position[static_cast<std::size_t>(cut.axes[0])] : nullptr;
    branch.cut = &cut;
    branch.left = label(left);
    branch.right = label(right);
  }
}

// Gives every particle its child, and bounds_ the children's extents.
void TreeBuilder::label_all() {
  if (axes_ == 0) {
    label_by_id();
    bounds_.assign(next_.size(), bounds_[0]);
    return;
  }
  switch (axes_) {
    case 1:
      label_and_measure<1>();
      break;
    case 2:
      label_and_measure<2>();
      break;
    default:
      label_and_measure<3>();
      break;
  }
}

// A particle whose coordinate is the cut's: the rest of the key decides.
bool TreeBuilder::goes_right(const Branch& branch, std::size_t particle) const {
  return !branch.cut->right_empty && !(key_of(particles_.point(particle), particles_.id[particle], branch.cut->axes,
                                              particles_.dims) < branch.cut->key);
}

template <int kAxes>
void TreeBuilder::label_and_measure() {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  constexpr auto kCount = static_cast<std::size_t>(kAxes);
  struct Range {
    std::array<double, kCount> lo;
    std::array<double, kCount> hi;
  };
  // Particles that reached their part are measured too, into the first entry, so that the pass has no branch for it.
  std::vector<Range> ranges(next_.size() + 1);
  for (Range& range : ranges) {
    range.lo.fill(kInfinity);
    range.hi.fill(-kInfinity);
  }
  std::array<const double*, kCount> x{};
  std::copy_n(particles_.position.begin(), kCount, x.begin());
  const bool measuring = !next_.empty();
  const Branch* const branches = branches_.data();
  std::int32_t* const label = result_.part.data();
  for (std::size_t i = 0; i < particles_.count; ++i) {
    if (label[i] < 0) continue;
    const Branch& branch = branches[label[i]];
    const double value = branch.x[i];
    bool right = value > branch.at;
    if (value == branch.at) [[unlikely]]
      right = goes_right(branch, i);
    const std::int32_t child = right ? branch.right : branch.left;
    label[i] = child;
    if (!measuring) continue;
    Range& range = ranges[static_cast<std::size_t>(std::max(child, -1) + 1)];
    for (std::size_t a = 0; a < kCount; ++a) {
      const double v = x[a][i];
      range.lo[a] = v < range.lo[a] ? v : range.lo[a];
      range.hi[a] = v > range.hi[a] ? v : range.hi[a];
    }
  }
  bounds_.resize(next_.size());
  for (std::size_t n = 0; n < next_.size(); ++n) {
    const Range& range = ranges[n + 1];
    bounds_[n].lo.fill(kNoImage);
    bounds_[n].not_hi.fill(kNoImage);
    for (std::size_t a = 0; a < kCount && range.lo[0] <= range.hi[0]; ++a) {
      bounds_[n].lo[a] = geometry::image(range.lo[a]);
      bounds_[n].not_hi[a] = ~geometry::image(range.hi[a]);
    }
  }
  reduce_bounds();
}

void TreeBuilder::label_by_id() {
  for (std::size_t i = 0; i < particles_.count; ++i) {
    std::int32_t& label = result_.part[i];
    if (label < 0) continue;
    const Branch& branch = branches_[at(label)];
    const bool right = !branch.cut->right_empty && particles_.id[i] >= branch.cut->key.id;
    label = right ? branch.right : branch.left;
  }
}

void TreeBuilder::reduce_bounds() {
  if (bounds_.empty()) return;
  const auto axes = at(axes_);
  std::vector<std::uint64_t> least(bounds_.size() * axes * 2);
  for (std::size_t n = 0, w = 0; n < bounds_.size(); ++n)
    for (std::size_t a = 0; a < axes; ++a, w += 2) {
      least[w] = bounds_[n].lo[a];
      least[w + 1] = bounds_[n].not_hi[a];
    }
  comm_.all_min(least);
  result_.reductions += (least.size() + kMessageWordsMax - 1) / kMessageWordsMax;
  for (std::size_t n = 0, w = 0; n < bounds_.size(); ++n)
    for (std::size_t a = 0; a < axes; ++a, w += 2) {
      bounds_[n].lo[a] = least[w];
      bounds_[n].not_hi[a] = least[w + 1];
    }
}

}  // namespace rcb::partition
