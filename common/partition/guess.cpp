#include "common/partition/guess.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "common/base/random.hpp"

namespace rcb::partition {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr std::size_t kPointsMin = 48;  // of the sample, to guess a node below the first
// The brackets on a way down hold at most this part of their particles together, which bounds the memory for those.
constexpr double kStashMax = 0.36;

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

// Also of the points strictly inside a box.
Bounds bounds_of(std::span<const SamplePoint> sample, int dims, const Point& core_lo, const Point& core_hi,
                 Bounds& core) {
  struct Range {
    Point lo{kInfinity, kInfinity, kInfinity};
    Point hi{-kInfinity, -kInfinity, -kInfinity};
  };
  std::array<Range, 2> ranges;
  for (const SamplePoint& point : sample) {
    bool inside = true;
    for (std::size_t a = 0; a < geometry::kDimsMax; ++a)
      inside &= (point.at[a] > core_lo[a]) & (point.at[a] < core_hi[a]);
    Range& range = ranges[static_cast<std::size_t>(inside)];
    for (std::size_t a = 0; a < geometry::kDimsMax; ++a) {
      range.lo[a] = point.at[a] < range.lo[a] ? point.at[a] : range.lo[a];
      range.hi[a] = point.at[a] > range.hi[a] ? point.at[a] : range.hi[a];
    }
  }
  const auto bounds_in = [dims](const Range& range) {
    Bounds bounds;
    for (std::size_t a = 0; a < at(dims) && range.lo[0] <= range.hi[0]; ++a) {
      bounds.lo[a] = geometry::image(range.lo[a]);
      bounds.not_hi[a] = ~geometry::image(range.hi[a]);
    }
    return bounds;
  };
  core = bounds_in(ranges[1]);
  for (std::size_t a = 0; a < geometry::kDimsMax; ++a) {
    ranges[0].lo[a] = std::min(ranges[0].lo[a], ranges[1].lo[a]);
    ranges[0].hi[a] = std::max(ranges[0].hi[a], ranges[1].hi[a]);
  }
  return bounds_in(ranges[0]);
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
  measured_depth_ = 0;
  for (std::size_t f = 0; f < frontier.size(); ++f) {
    root_ = static_cast<int>(f);
    const FrontierNode& from = frontier[f];
    Seed seed;
    seed.range = from.range;
    seed.outer = from.bounds;
    roots_.push_back(grow_node(seed, sample.subspan(from.sample_first, from.sample_last - from.sample_first), &from));
  }
}

int Guess::grow_node(const Seed& seed, std::span<SamplePoint> sample, const FrontierNode* exact) {
  const auto index = static_cast<int>(nodes_.size());
  GuessNode node;
  node.range = seed.range;
  node.depth = seed.depth;
  node.root = root_;
  node.outer = seed.outer;
  const bool part = seed.range.leaf();
  const std::uint64_t count = rule_.quota(seed.range.first, seed.range.last);
  const std::uint64_t quota = part ? 0 : rule_.quota(seed.range.first, seed.range.middle());
  if (exact != nullptr || part || count == 0 || rule_.fixed()) {
    node.certain = true;
    node.axes = exact != nullptr ? exact->axes : rule_.axes_of(seed.range, count == 0 ? Bounds{} : seed.outer);
    node.inner = !part && (exact != nullptr || count == 0 || sample.size() >= kPointsMin);
  } else {
    node.inner = descends(seed, sample, node);
  }
  node.all_left = node.inner && quota >= count;
  const bool mended = exact != nullptr && exact->misses > 0;  // nothing is guessed below
  double spread = 0;
  double stashed = seed.stashed;
  std::size_t left_points = sample.size();
  node.expected = static_cast<double>(count);
  if (node.all_left) {
    node.lo = node.hi = kInfinity;
  } else if (node.inner) {
    const double sigmas = (mended ? 4 : 1) * refinement_.sigmas;
    left_points = bracket(seed, sample, node, sigmas, spread);
    const double width = (2 * sigmas * std::sqrt(spread) + 2) / static_cast<double>(sample.size());
    node.expected *= std::min(width, 1.0);
    stashed += std::min(width, 1.0);
    if (exact == nullptr && stashed > kStashMax) node.inner = false;  // the node begins the next pass
  }
  if (mended) {
    node.whole = false;
    const bool inside = exact->misses == 1 && node.lo <= exact->side_hi && node.hi >= exact->side_lo;
    node.lo = inside ? std::max(node.lo, exact->side_lo) : exact->side_lo;
    node.hi = inside ? std::min(node.hi, exact->side_hi) : exact->side_hi;
  }
  depth_max_ = std::max(depth_max_, seed.depth);
  if (!node.certain) measured_depth_ = std::max(measured_depth_, seed.depth);
  nodes_.push_back(node);
  if (node.inner)
    grow_children(index, seed, mended ? sample.first(0) : sample, mended ? 0 : left_points, spread, stashed);
  nodes_[at(index)].end = static_cast<int>(nodes_.size());
  return index;
}

void Guess::grow_children(int index, const Seed& seed, std::span<SamplePoint> sample, std::size_t left_points,
                          double spread, double stashed) {
  const GuessNode node = nodes_[at(index)];
  Seed left = seed;
  left.range = seed.range.left();
  left.depth = seed.depth + 1;
  left.spread = spread;
  left.stashed = stashed;
  Seed right = left;
  right.range = seed.range.right();
  const std::size_t axis = at(node.axes[0]);
  if (node.all_left) {
    right.outer = Bounds{};
  } else {
    if (node.hi < kInfinity) left.outer.not_hi[axis] = std::max(left.outer.not_hi[axis], ~geometry::image(node.hi));
    if (node.lo > -kInfinity) right.outer.lo[axis] = std::max(right.outer.lo[axis], geometry::image(node.lo));
    left.core_hi[axis] = std::min(left.core_hi[axis], node.lo);
    right.core_lo[axis] = std::max(right.core_lo[axis], node.hi);
  }
  const int left_node = grow_node(left, sample.first(left_points), nullptr);
  const int right_node = grow_node(right, sample.subspan(left_points), nullptr);
  nodes_[at(index)].left = left_node;
  nodes_[at(index)].right = right_node;
}

// Whether to guess a node below the first, and its axis order.
bool Guess::descends(const Seed& seed, std::span<const SamplePoint> sample, GuessNode& node) const {
  if (sample.size() < kPointsMin) return false;
  Bounds core;
  const Bounds inner = bounds_of(sample, dims_, seed.core_lo, seed.core_hi, core);
  node.axes = rule_.axes_of(seed.range, inner);
  node.certain = !rule_.sticky() && order_is_certain(node.axes, core, seed.outer);
  return node.certain || rule_.sticky() || order_is_likely(node.axes, inner, seed.outer, sample.size());
}

bool Guess::order_is_certain(const AxisOrder& axes, const Bounds& core, const Bounds& outer) const {
  for (std::size_t i = 0; i + 1 < at(rule_.axes()); ++i) {
    const double least = extent_of(core, at(axes[i]));
    const double most = extent_of(outer, at(axes[i + 1]));
    if (!(least > most || (least == most && axes[i] < axes[i + 1]))) return false;
  }
  return true;
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

std::size_t Guess::bracket(const Seed& seed, std::span<SamplePoint> sample, GuessNode& node, double sigmas,
                           double& spread) const {
  const auto points = static_cast<double>(sample.size());
  const double part = static_cast<double>(rule_.quota(seed.range.first, seed.range.middle())) /
                      static_cast<double>(rule_.quota(seed.range.first, seed.range.last));
  const double larger = std::max(part, 1 - part);
  spread = points * part * (1 - part) + larger * larger * seed.spread;
  const double reach = sigmas * std::sqrt(spread) + 1;
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
  node.whole = static_cast<double>(ties) > 4 + reach / 8;
  return middle;
}

}  // namespace rcb::partition
