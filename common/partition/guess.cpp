#include "common/partition/guess.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "common/base/random.hpp"

namespace rcb::partition {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr std::size_t kPointsMin = 48;  // of the sample, to guess a node below the first
constexpr double kBracketMax = 0.4;     // of a node's points, likewise

std::size_t at(int index) { return static_cast<std::size_t>(index); }

// The key order, without making keys.
struct Before {
  std::size_t first;
  const AxisOrder& axes;
  int dims;
  bool operator()(const SamplePoint& a, const SamplePoint& b) const {
    if (a.at[first] != b.at[first]) [[likely]]
      return a.at[first] < b.at[first];
    return key_of(a.at, a.id, axes, dims) < key_of(b.at, b.id, axes, dims);
  }
};

Bounds bounds_of(std::span<const SamplePoint> sample, int dims) {
  Bounds bounds;
  if (sample.empty()) return bounds;
  Point lo = sample[0].at;
  Point hi = lo;
  for (const SamplePoint& point : sample)
    for (std::size_t a = 0; a < geometry::kDimsMax; ++a) {
      lo[a] = point.at[a] < lo[a] ? point.at[a] : lo[a];
      hi[a] = point.at[a] > hi[a] ? point.at[a] : hi[a];
    }
  for (std::size_t a = 0; a < at(dims); ++a) {
    bounds.lo[a] = geometry::image(lo[a]);
    bounds.not_hi[a] = ~geometry::image(hi[a]);
  }
  return bounds;
}

double extent_of(const Bounds& bounds, std::size_t axis) {
  if (bounds.lo[axis] > ~bounds.not_hi[axis]) return 0;
  return geometry::extent(geometry::value_of_image(bounds.lo[axis]), geometry::value_of_image(~bounds.not_hi[axis]));
}

}  // namespace

std::vector<SamplePoint> draw_sample(Comm& comm, const particles::ParticleView& particles, std::uint64_t stride) {
  std::vector<SamplePoint> mine;
  mine.reserve(particles.count / stride + 1);
  const std::uint64_t seed = mix64(static_cast<std::uint64_t>(comm.rank()));
  for (std::uint64_t first = 0; first < particles.count; first += stride) {
    // Uniform in the block; a block that is not full is drawn from less often.
    const std::uint64_t i = first + Random(seed ^ first).below(stride);
    if (i < particles.count) mine.push_back({particles.point(i), particles.id[i]});
  }
  std::vector<std::byte> bytes;
  std::vector<std::size_t> sizes;
  comm.all_gather(std::as_bytes(std::span(mine)), bytes, sizes);
  std::vector<SamplePoint> all(bytes.size() / sizeof(SamplePoint));
  if (!bytes.empty()) std::memcpy(static_cast<void*>(all.data()), bytes.data(), bytes.size());
  return all;
}

void Guess::grow(std::span<const FrontierNode> frontier, std::span<SamplePoint> sample) {
  nodes_.clear();
  roots_.clear();
  depth_max_ = 0;
  for (std::size_t f = 0; f < frontier.size(); ++f) {
    root_ = static_cast<int>(f);
    const FrontierNode& from = frontier[f];
    const Seed seed{from.range, 0, from.bounds, 0};
    roots_.push_back(grow_node(seed, sample.subspan(from.sample_first, from.sample_last - from.sample_first), &from));
  }
}

int Guess::grow_node(const Seed& seed, std::span<SamplePoint> sample, const FrontierNode* exact) {
  const auto index = static_cast<int>(nodes_.size());
  GuessNode node;
  node.range = seed.range;
  node.depth = seed.depth;
  node.root = root_;
  const std::uint64_t count = rule_.quota(seed.range.first, seed.range.last);
  const std::uint64_t quota = seed.range.leaf() ? 0 : rule_.quota(seed.range.first, seed.range.middle());
  if (exact != nullptr) {
    node.inner = !seed.range.leaf();
    node.axes = rule_.axes_of(seed.range, seed.outer);
  } else if (!seed.range.leaf() && count == 0) {
    node.inner = true;
    node.axes = rule_.axes_of(seed.range, Bounds{});
  } else {
    node.inner = !seed.range.leaf() && descends(seed, sample, node);
  }
  node.all_left = node.inner && quota >= count;
  double spread = 0;
  std::size_t left_points = sample.size();
  if (node.all_left) {
    node.lo = node.hi = kInfinity;
  } else if (exact != nullptr && node.inner && exact->has_side()) {
    node.lo = exact->side_lo;
    node.hi = exact->side_hi;
    left_points = sample.size() / 2;  // nothing is guessed below
  } else if (node.inner) {
    left_points = bracket(seed, sample, node, spread);
    // Too wide to be worth the guess: the node begins the next pass, with exact bounds.
    const double width = (2 * refinement_.sigmas * std::sqrt(spread) + 2) / static_cast<double>(sample.size());
    if (exact == nullptr && width > kBracketMax) node.inner = false;
  }
  depth_max_ = std::max(depth_max_, seed.depth);
  nodes_.push_back(node);
  if (node.inner) {
    Seed left{seed.range.left(), seed.depth + 1, seed.outer, spread};
    Seed right{seed.range.right(), seed.depth + 1, seed.outer, spread};
    const std::size_t axis = at(node.axes[0]);
    if (node.all_left) {
      right.outer = Bounds{};
    } else {
      if (node.hi < kInfinity) left.outer.not_hi[axis] = ~geometry::image(node.hi);
      if (node.lo > -kInfinity) right.outer.lo[axis] = geometry::image(node.lo);
    }
    const bool blind = exact != nullptr && exact->has_side();
    nodes_[at(index)].left = grow_node(left, blind ? sample.first(0) : sample.first(left_points), nullptr);
    nodes_[at(index)].right = grow_node(right, blind ? sample.first(0) : sample.subspan(left_points), nullptr);
  }
  nodes_[at(index)].end = static_cast<int>(nodes_.size());
  return index;
}

// Whether to guess a node below the first, and its axis order.
bool Guess::descends(const Seed& seed, std::span<const SamplePoint> sample, GuessNode& node) const {
  if (sample.size() < kPointsMin) return false;
  if (rule_.fixed()) {
    node.axes = rule_.axes_of(seed.range, seed.outer);
    return true;
  }
  const Bounds inner = bounds_of(sample, dims_);
  node.axes = rule_.axes_of(seed.range, inner);
  return rule_.sticky() || order_is_likely(node.axes, inner, seed.outer, sample.size());
}

// True unless the longest axis is about as likely to be another.
bool Guess::order_is_likely(const AxisOrder& axes, const Bounds& inner, const Bounds& outer, std::size_t points) const {
  const std::size_t longest = at(axes[0]);
  const double extent = extent_of(inner, longest);
  for (std::size_t a = 0; a < at(rule_.axes()); ++a) {
    if (a == longest) continue;
    const double most = extent_of(outer, a);
    const bool certain = extent > most || (extent == most && longest < a);
    const double margin = std::max(1 - 16 / static_cast<double>(points), 0.0);
    if (!certain && !(extent * margin > extent_of(inner, a))) return false;
  }
  return true;
}

std::size_t Guess::bracket(const Seed& seed, std::span<SamplePoint> sample, GuessNode& node, double& spread) const {
  const auto points = static_cast<double>(sample.size());
  const double part = static_cast<double>(rule_.quota(seed.range.first, seed.range.middle())) /
                      static_cast<double>(rule_.quota(seed.range.first, seed.range.last));
  const double larger = std::max(part, 1 - part);
  spread = points * part * (1 - part) + larger * larger * seed.spread;
  const double reach = refinement_.sigmas * std::sqrt(spread) + 1;
  const auto middle = static_cast<std::size_t>(std::min(part * points, points));
  const double low = std::floor(part * points - reach);
  const double high = std::ceil(part * points + reach);
  const Before before{at(node.axes[0]), node.axes, dims_};
  const auto begin = sample.begin();
  if (middle < sample.size())
    std::nth_element(begin, begin + static_cast<std::ptrdiff_t>(middle), sample.end(), before);
  const auto split = begin + static_cast<std::ptrdiff_t>(middle);
  node.lo = -kInfinity;
  node.hi = kInfinity;
  if (low >= 0 && low < points) {
    const auto found = begin + static_cast<std::ptrdiff_t>(low);
    if (found != split) std::nth_element(begin, found, split, before);
    node.lo_key = key_of(found->at, found->id, node.axes, dims_);
    node.lo = node.lo_key.at[0];
  }
  if (high < points) {
    const auto found = begin + static_cast<std::ptrdiff_t>(high);
    std::nth_element(split, found, sample.end(), before);
    node.hi_key = key_of(found->at, found->id, node.axes, dims_);
    node.hi = node.hi_key.at[0];
  }
  // Where many share the bracket's coordinates the rest of the key narrows it.
  std::size_t ties = 0;
  const std::size_t axis = at(node.axes[0]);
  for (const SamplePoint& point : sample)
    ties += static_cast<std::size_t>(point.at[axis] == node.lo) + static_cast<std::size_t>(point.at[axis] == node.hi);
  node.whole = static_cast<double>(ties) > 2 * reach + 2;
  return middle;
}

}  // namespace rcb::partition
