#include "common/partition/incremental/guess_tables.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "common/base/index.hpp"
#include "common/geometry/axes.hpp"

namespace rcb::partition {
namespace {

constexpr std::int64_t kLeastWord = std::numeric_limits<std::int64_t>::min();
constexpr std::int64_t kMostWord = std::numeric_limits<std::int64_t>::max();
constexpr float kInfinite = std::numeric_limits<float>::infinity();

std::int64_t signed_order_bits(double value) {
  return static_cast<std::int64_t>(geometry::order_bits(value) ^ (std::uint64_t{1} << 63U));
}

}  // namespace

GuessTables::GuessTables(const Guess& guess, std::span<const NodeRange> roots, int own_dims) : dims(own_dims) {
  for (auto& row : least) row.fill(kInfinite);
  most = least;
  for (auto& row : lo) row.fill(-kInfinite);
  for (auto& row : hi) row.fill(kInfinite);
  for (auto& row : inner_lo) row.fill(-geometry::Box::kInfinity);
  for (auto& row : inner_hi) row.fill(geometry::Box::kInfinity);
  sure_lo = inner_lo;
  sure_hi = inner_hi;
  for (std::size_t a = 0; a < box_lo.size(); ++a) {  // empty on the axes that count
    box_lo[a].fill(a < at(dims) ? geometry::Box::kInfinity : -geometry::Box::kInfinity);
    box_hi[a].fill(a < at(dims) ? -geometry::Box::kInfinity : geometry::Box::kInfinity);
  }
  fit_axes(guess);
  std::vector<Node> level = add_roots(guess, roots);
  for (std::size_t l = 0; l < kGuessLevels; ++l) {
    for (Words& words : keys[l].least) words.fill(kMostWord);
    for (Words& words : keys[l].most) words.fill(kMostWord);
    std::vector<Node> below;
    for (std::size_t k = 0; k < level.size(); ++k) {
      next[l][k] = static_cast<std::int32_t>(below.size());
      keys[l].next[k] = next[l][k];
      if (level[k].ends) {
        below.push_back(level[k]);
        continue;
      }
      const NodeRange& range = level[k].range;
      levels = l + 1;
      add_cut(l, k, guess.brackets[at(range.node)]);
      for (const NodeRange& child : {range.left(), range.right()})
        below.push_back({child, child.leaf() || !guess.brackets[at(child.node)].known, false});
    }
    for (std::size_t k = 0; k < kLeaves; ++k) steps[l][k] = step(l, k);
    level = std::move(below);
  }
  leaves = level.size();
  for (std::size_t k = 0; k < leaves; ++k) add_leaf(k, guess, level[k]);
}

void GuessTables::fit_axes(const Guess& guess) {
  geometry::Box all;
  for (const geometry::Box& seen : guess.seen) all.extend(seen);
  for (std::size_t a = 0; a < at(dims) && !all.empty(dims); ++a) rounded.fit(a, all.lo[a], all.hi[a]);
  std::fill(rounded.scale.begin() + dims, rounded.scale.end(), 0);  // they repeat the first axis
}

std::vector<GuessTables::Node> GuessTables::add_roots(const Guess& guess, std::span<const NodeRange> roots) {
  below_root = roots.size() > 1 || roots[0].parts() < guess.parts;
  std::vector<Node> level;
  int p = 0;
  const auto add_fixed = [&](int until) {
    for (; p < until; ++p) {
      first[at(p)] = static_cast<std::int32_t>(level.size());
      level.push_back({{0, p, p + 1}, true, true});
    }
  };
  for (const NodeRange& root : roots) {
    add_fixed(root.first);
    for (; p < root.last; ++p) first[at(p)] = static_cast<std::int32_t>(level.size());
    level.push_back({root, root.leaf() || !guess.brackets[at(root.node)].known, false});
  }
  add_fixed(guess.parts);
  return level;
}

void GuessTables::add_cut(std::size_t level, std::size_t node, const KeyBracket& bracket) {
  // Rounded as the inner regions' bounds are. Where whole keys count, these decide of all that have the bounds' rounded
  // coordinates; else they are boundary particles.
  const float from = rounded(at(bracket.axes[0]), bracket.least.at[0]);
  const float to = rounded(at(bracket.axes[0]), bracket.most.at[0]);
  least[level][node] = bracket.whole ? from : std::nextafter(from, -kInfinite);
  most[level][node] = bracket.whole ? to : std::nextafter(to, kInfinite);
  on_y[level][node] = bracket.axes[0] == 1 ? -1 : 0;
  on_z[level][node] = bracket.axes[0] == 2 ? -1 : 0;
  Keys& words = keys[level];
  words.whole |= bracket.whole;
  for (std::size_t w = 0; w < bracket.axes.size(); ++w) {
    words.axis[w][node] = bracket.axes[w];
    const bool counts = bracket.whole || w == 0;
    words.least[w][node] = counts ? signed_order_bits(bracket.least.at[w]) : kLeastWord;
    words.most[w][node] = counts ? signed_order_bits(bracket.most.at[w]) : kMostWord;
  }
  words.least.back()[node] = bracket.whole ? bracket.least.id : kLeastWord;
  words.most.back()[node] = bracket.whole ? bracket.most.id : kMostWord;
}

GuessTables::Step GuessTables::step(std::size_t level, std::size_t node) const {
  const Keys& words = keys[level];
  Step one;
  for (std::size_t w = 0; w <= geometry::kDimsMax; ++w) {
    const std::int64_t from = w < geometry::kDimsMax ? words.axis[w][node] : geometry::kDimsMax;
    const std::size_t lane = geometry::kDimsMax - w;
    one.least[lane] = words.least[w][node];
    one.most[lane] = words.most[w][node];
    one.order[2 * lane] = static_cast<std::int32_t>(2 * from);
    one.order[2 * lane + 1] = static_cast<std::int32_t>(2 * from + 1);
  }
  one.next = static_cast<std::int32_t>(words.next[node]);
  return one;
}

void GuessTables::add_leaf(std::size_t leaf, const Guess& guess, const Node& node) {
  const auto p = at(node.range.first);
  part[leaf] = node.range.first;
  if (node.fixed) return;  // its rounded bounds stay infinite: its particles are looked at no further
  for (std::size_t a = 0; a < at(dims); ++a) {
    box_lo[a][leaf] = guess.seen[p].lo[a];
    box_hi[a][leaf] = guess.seen[p].hi[a];
    inner_lo[a][leaf] = guess.inner[p].lo[a];
    inner_hi[a][leaf] = guess.inner[p].hi[a];
    tied_faces |= !set_bounds(leaf, a) && guess.tied;
  }
}

geometry::Box GuessTables::box(std::size_t leaf) const {
  geometry::Box box;
  for (std::size_t a = 0; a < at(dims); ++a) {
    box.lo[a] = box_lo[a][leaf];
    box.hi[a] = box_hi[a][leaf];
  }
  return box;
}

void GuessTables::extend(std::size_t leaf, const geometry::Point& position) {
  for (std::size_t a = 0; a < at(dims); ++a) {
    if (position[a] >= box_lo[a][leaf] && position[a] <= box_hi[a][leaf]) continue;
    box_lo[a][leaf] = std::min(box_lo[a][leaf], position[a]);
    box_hi[a][leaf] = std::max(box_hi[a][leaf], position[a]);
    set_bounds(leaf, a);
  }
}

bool GuessTables::set_bounds(std::size_t leaf, std::size_t a) {
  const double from = box_lo[a][leaf];
  const double to = box_hi[a][leaf];
  float below = rounded(a, from);
  float above = rounded(a, to);
  const bool tells_below = rounded(a, std::nextafter(from, -geometry::Box::kInfinity)) < below;
  const bool tells_above = rounded(a, std::nextafter(to, geometry::Box::kInfinity)) > above;
  if (tells_below) below = std::nextafter(below, -kInfinite);
  if (tells_above) above = std::nextafter(above, kInfinite);
  const bool none = from > to;
  lo[a][leaf] = none ? kInfinite : std::max(below, rounded(a, inner_lo[a][leaf]));
  hi[a][leaf] = none ? -kInfinite : std::min(above, rounded(a, inner_hi[a][leaf]));
  sure_lo[a][leaf] = std::max(from, std::nextafter(inner_lo[a][leaf], geometry::Box::kInfinity));
  sure_hi[a][leaf] = std::min(to, std::nextafter(inner_hi[a][leaf], -geometry::Box::kInfinity));
  return tells_below && tells_above;
}

}  // namespace rcb::partition
