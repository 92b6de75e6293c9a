#include "common/partition/build_tree.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

#include "common/partition/wide_sum.hpp"

namespace rcb::partition {
namespace {

constexpr std::uint64_t kNoImage = ~std::uint64_t{0};
constexpr std::size_t kSampleMax = 256;  // particles of a rank that are looked at to choose a map
constexpr std::size_t kSampleBins = 512;
constexpr std::size_t kSampleWords = 2 * kSampleBins + 1;

std::size_t at(int index) { return static_cast<std::size_t>(index); }

// Least and greatest of an array. Four of each at once, since one would wait for itself.
void least_and_most(std::span<const double> values, double& lo, double& hi) {
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
    : comm_(comm),
      particles_(particles),
      options_(options),
      axes_(axes),
      q_axes_(at(std::max(axes, 1))),
      rule_(options, axes) {
  CutTree& tree = result_.tree;
  tree.dims = particles.dims;
  tree.method = options.method;
  tree.parts = options.parts;
  const auto& sizes = options.part_sizes;
  if (std::ranges::any_of(sizes, [&](double size) { return size != sizes[0]; })) tree.part_sizes = sizes;
  tree.cuts.resize(at(options.parts) - 1);
  // (1 + level tolerance)^levels <= 1 + tolerance
  const double levels = std::bit_width(static_cast<unsigned>(options.parts - 1));
  level_tolerance_ = std::expm1(std::log1p(options.cut_tolerance) / std::max(levels, 1.0));
}

PartitionResult TreeBuilder::build() {
  if (options_.parts == 1) {
    result_.part.resize(particles_.count);
    std::fill(result_.part.begin(), result_.part.end(), 0);
    return std::move(result_);
  }
  measure_all();
  if (!scale_) result_.counts.resize(at(options_.parts));
  make_records();
  spans_ = records_.spans();
  for (const Span& span : spans_) starts_.push_back(span.first);
  ends_.resize(starts_.size() * at(options_.parts));
  Selector selector(comm_, particles_, maps_, axes_, scale_ ? &*scale_ : nullptr, options_.limits);
  std::vector<Question> asked;
  while (!level_.empty()) {
    order_axes();
    asked.clear();
    for (const Node& node : level_) asked.push_back(question(node));
    selector.select(asked, spans_);
    split(asked);
    level_.swap(next_);
    spans_.swap(next_spans_);
  }
  result_.part = records_.into_parts(ends_, options_.parts);
  result_.rounds = selector.rounds();
  result_.reductions += selector.reductions();
  return std::move(result_);
}

// The root: number of particles, bounds, weights.
void TreeBuilder::measure_all() {
  std::vector<std::uint64_t> least(2 * geometry::kDimsMax + 2, kNoImage);
  for (int a = 0; a < axes_ && particles_.count > 0; ++a) {
    double lo = particles_.position[at(a)][0];
    double hi = lo;
    least_and_most({particles_.position[at(a)], particles_.count}, lo, hi);
    least[at(a)] = geometry::image(lo);
    least[geometry::kDimsMax + at(a)] = ~geometry::image(hi);
  }
  if (axes_ > 0) {
    std::ranges::copy(weight_images(particles_), least.end() - 2);
  } else if (particles_.count > 0) {
    const auto [lo, hi] = std::minmax_element(particles_.id, particles_.id + particles_.count);
    least[0] = static_cast<std::uint64_t>(*lo);
    least[geometry::kDimsMax] = ~static_cast<std::uint64_t>(*hi);
  }
  comm_.all_min(least);
  const bool none = least[0] == kNoImage;
  for (std::size_t a = 0; a < at(axes_) && !none; ++a) {
    lo_[a] = geometry::value_of_image(least[a]);
    hi_[a] = geometry::value_of_image(~least[geometry::kDimsMax + a]);
  }
  id_lo_ = axes_ == 0 && !none ? static_cast<Id>(least[0]) : 0;
  id_hi_ = axes_ == 0 && !none ? static_cast<Id>(~least[geometry::kDimsMax]) : 0;
  std::vector<std::uint64_t> sums = sample_maps();
  sums.push_back(particles_.count);
  comm_.all_sum(sums);
  const std::uint64_t count = sums.back();
  result_.reductions += 2;
  choose_maps(sums);
  Point extents{};
  for (std::size_t a = 0; a < at(axes_); ++a) extents[a] = geometry::extent(lo_[a], hi_[a]);
  rule_.set_all(count, extents);

  Node root;
  root.range = {0, 0, options_.parts};
  root.count = count;
  for (std::size_t a = 0; a < q_axes_ && count > 0; ++a) {
    root.bounds.lo[a] = axes_ == 0 ? maps_[a](id_lo_) : maps_[a](lo_[a]);
    root.bounds.hi[a] = axes_ == 0 ? maps_[a](id_hi_) : maps_[a](hi_[a]);
  }
  if (const auto range = weight_range_of_images(std::span<const std::uint64_t>(least).last<2>())) {
    scale_.emplace(range->largest, count);
    for (std::size_t i = 0; i < particles_.count; ++i) root.weight += (*scale_)(particles_.weight[i]);
    all_sum_wide(comm_, {&root.weight, 1});
    ++result_.reductions;
  }
  level_.assign(1, root);
}

// How some of the particles spread over an axis, in equal steps of the value and of the image: where the former puts
// most of them into one place, and the latter doesn't, the image suits the axis (many decades of scale).
std::vector<std::uint64_t> TreeBuilder::sample_maps() const {
  // By axis: the bins of both maps, and how many ranks have a value that its integer does not tell.
  std::vector<std::uint64_t> counts(at(axes_) * kSampleWords, 0);
  const std::size_t stride = std::max<std::size_t>(particles_.count / kSampleMax, 1);
  std::vector<double> sample;
  for (std::size_t a = 0; a < at(axes_); ++a) {
    sample.clear();
    for (std::size_t i = 0; i < particles_.count; i += stride) sample.push_back(particles_.position[a][i]);
    const std::array maps{AxisMap::by_value(lo_[a], hi_[a]), AxisMap::by_image(lo_[a], hi_[a])};
    for (std::size_t m = 0; m < maps.size(); ++m) {
      const auto top = static_cast<std::uint64_t>(std::max(maps[m](hi_[a]), 1));
      for (const double x : sample)
        ++counts[a * kSampleWords + m * kSampleBins + static_cast<std::uint64_t>(maps[m](x)) * (kSampleBins - 1) / top];
    }
    if (maps[0].even() && zeros_of_told(maps[0], sample) < 0) ++counts[(a + 1) * kSampleWords - 1];
  }
  return counts;
}

void TreeBuilder::choose_maps(std::span<const std::uint64_t> samples) {
  if (axes_ == 0) maps_[0] = AxisMap::of_ids(id_lo_, id_hi_);
  for (std::size_t a = 0; a < at(axes_); ++a) {
    const auto most = [&](std::size_t m) {
      return std::ranges::max(samples.subspan(a * kSampleWords + m * kSampleBins, kSampleBins));
    };
    maps_[a] = most(0) > 2 * most(1) ? AxisMap::by_image(lo_[a], hi_[a]) : AxisMap::by_value(lo_[a], hi_[a]);
    told_[a] = maps_[a].even() && samples[(a + 1) * kSampleWords - 1] == 0 ? 1 : 0;
  }
}

// Axes whose integers may tell the coordinates are found to do so, or not, while the records are made.
void TreeBuilder::make_records() {
  const bool tell = std::ranges::max(told_) != 0 &&
                    std::all_of(maps_.begin(), maps_.begin() + axes_, [](const AxisMap& map) { return map.even(); });
  const std::array<int, geometry::kDimsMax> zeros =
      records_.build(particles_, axes_, maps_, options_.limits.chunk_max, tell);
  if (!tell) return;
  // One more than the zeros; 0 where they don't.
  for (std::size_t a = 0; a < told_.size(); ++a)
    told_[a] = told_[a] == 0 ? 0 : static_cast<std::uint64_t>(zeros[a] + 1);
  comm_.all_min(told_);
  ++result_.reductions;
  for (std::size_t a = 0; a < at(axes_); ++a)
    if (told_[a] != 0) maps_[a].set_exact(static_cast<unsigned>(told_[a] - 1));
}

Extents TreeBuilder::extents_of(const QBounds& bounds) const {
  Extents extents;
  for (std::size_t a = 0; a < at(axes_) && !bounds.empty(); ++a) {
    const AxisMap& map = maps_[a];
    extents.least[a] = std::max(geometry::extent(map.most(bounds.lo[a]), map.least(bounds.hi[a])), 0.0);
    extents.most[a] = geometry::extent(map.least(bounds.lo[a]), map.most(bounds.hi[a]));
  }
  return extents;
}

void TreeBuilder::order_axes() {
  std::vector<std::size_t> open;
  for (std::size_t n = 0; n < level_.size(); ++n) {
    Node& node = level_[n];
    if (const auto axes = rule_.axes_of(node.range, extents_of(node.bounds)))
      node.axes = *axes;
    else
      open.push_back(n);
  }
  if (open.empty()) return;
  const std::vector<Point> extents = measure(open);
  for (std::size_t o = 0; o < open.size(); ++o) {
    Node& node = level_[open[o]];
    node.axes = *rule_.axes_of(node.range, {extents[o], extents[o]});
  }
}

std::vector<Point> TreeBuilder::measure(std::span<const std::size_t> nodes) {
  const std::size_t words = 2 * at(axes_);
  std::vector<std::uint64_t> least(nodes.size() * words, kNoImage);
  const std::size_t chunks = starts_.size();
  for (std::size_t n = 0; n < nodes.size(); ++n) {
    const QBounds& bounds = level_[nodes[n]].bounds;
    std::uint64_t* const own = &least[n * words];
    for (const Span& span : std::span(spans_).subspan(nodes[n] * chunks, chunks))
      for (const Record& record : span.all())
        for (std::size_t a = 0; a < at(axes_); ++a) {
          if (record.q[a] != bounds.lo[a] && record.q[a] != bounds.hi[a]) continue;
          const std::uint64_t image = geometry::image(particles_.position[a][span.base + record.index]);
          own[2 * a] = std::min(own[2 * a], image);
          own[2 * a + 1] = std::min(own[2 * a + 1], ~image);
        }
  }
  result_.reductions += all_min_in_messages(comm_, least);
  std::vector<Point> extents(nodes.size());
  for (std::size_t n = 0; n < nodes.size(); ++n)
    for (std::size_t a = 0; a < at(axes_); ++a)
      extents[n][a] = geometry::extent(geometry::value_of_image(least[n * words + 2 * a]),
                                       geometry::value_of_image(~least[n * words + 2 * a + 1]));
  return extents;
}

Question TreeBuilder::question(const Node& node) const {
  Question ask;
  ask.axes = node.axes;
  ask.bounds = node.bounds;
  ask.count = node.count;
  ask.weight = node.weight;
  const auto [index, first, last] = node.range;
  ask.left_size = rule_.size(first, node.range.middle());
  ask.size = rule_.size(first, last);
  if (options_.cut_tolerance > 0) {
    ask.rank = floor_share(node.count, ask.left_size, ask.size);
    ask.slack = slack_of(node);
  } else {
    ask.rank = rule_.quota(first, node.range.middle());
  }
  ask.search = !node.bounds.empty() && (scale_ || ask.rank < ask.count);
  return ask;
}

// The same fraction of either side's target, hence of the smaller one.
u128 TreeBuilder::slack_of(const Node& node) const {
  const u128 left = rule_.size(node.range.first, node.range.middle());
  const u128 right = rule_.size(node.range.middle(), node.range.last);
  const double share = quotient(std::min(left, right), left + right);
  const double load = scale_ ? static_cast<double>(node.weight) : static_cast<double>(node.count);
  return static_cast<u128>(std::min(level_tolerance_, 1.0) * share * load);
}

void TreeBuilder::split(std::span<const Question> answers) {
  next_.clear();
  next_spans_.clear();
  for (std::size_t n = 0; n < level_.size(); ++n) {
    const Node& node = level_[n];
    const Question& answer = answers[n];
    Cut& cut = result_.tree.cuts[at(node.range.node)];
    cut.axes = answer.axes;
    cut.right_empty = answer.right_empty;
    if (!cut.right_empty) {
      for (std::size_t w = 0; w < at(axes_); ++w) cut.key.at[w] = geometry::value_of_image(answer.key[w]);
      cut.key.id = static_cast<Id>(answer.key[at(axes_)]);
    }
    Node left = node;
    Node right = node;
    left.range = node.range.left();
    right.range = node.range.right();
    left.count = answer.right_empty ? node.count : answer.left_count;
    left.weight = answer.right_empty ? node.weight : answer.left_weight;
    right.count = node.count - left.count;
    right.weight = node.weight - left.weight;
    left.bounds = right.bounds = QBounds{};
    take_child(left, false, n);
    take_child(right, true, n);
  }
  reduce_bounds();
}

void TreeBuilder::take_child(const Node& child, bool right, std::size_t parent) {
  const std::size_t chunks = starts_.size();
  const std::span<const Span> from = std::span<const Span>(spans_).subspan(parent * chunks, chunks);
  if (child.range.leaf()) {
    if (!scale_) result_.counts[at(child.range.first)] = child.count;
    for (std::size_t c = 0; c < chunks; ++c) {
      const Record* const end = right ? from[c].last : from[c].middle;
      ends_[c * at(options_.parts) + at(child.range.first)] = static_cast<std::size_t>(end - starts_[c]);
    }
    return;
  }
  next_.push_back(child);
  for (const Span& span : from) {
    Record* const first = right ? span.middle : span.first;
    Record* const last = right ? span.last : span.middle;
    next_spans_.push_back({first, first, last, last, nullptr, nullptr, span.base});
    widen(next_.back().bounds, {first, last});
  }
}

void TreeBuilder::reduce_bounds() {
  std::vector<std::uint64_t> least;
  least.reserve(next_.size() * q_axes_ * 2);
  for (const Node& node : next_)
    for (std::size_t a = 0; a < q_axes_; ++a) {
      least.push_back(static_cast<std::uint64_t>(node.bounds.lo[a]));
      least.push_back(static_cast<std::uint64_t>(std::int64_t{QBounds::kNone} - node.bounds.hi[a]));
    }
  result_.reductions += all_min_in_messages(comm_, least);
  std::size_t word = 0;
  for (Node& node : next_)
    for (std::size_t a = 0; a < q_axes_; ++a) {
      node.bounds.lo[a] = static_cast<std::int32_t>(least[word++]);
      node.bounds.hi[a] = static_cast<std::int32_t>(QBounds::kNone - static_cast<std::int64_t>(least[word++]));
    }
}

}  // namespace rcb::partition
