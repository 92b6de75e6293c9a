#include "common/partition/search/node_axes.hpp"

#include <algorithm>
#include <utility>

#include "common/base/index.hpp"

namespace rcb::partition {

void NodeAxes::order(std::span<Node> nodes) {
  std::vector<Node*> unordered;
  for (Node& node : nodes) {
    const geometry::Box wholes = box_of(buckets_, node.wholes);
    node.points.one_place.all = in_one_place(node, wholes);
    if (const auto axes = rule_.axes_of(node.range, node.points.one_place.all ? Extents{} : extents_of(node, wholes)))
      node.axes = *axes;
    else
      unordered.push_back(&node);
  }
  if (unordered.empty()) return;
  const std::vector<Point> extents = measure(unordered);
  for (std::size_t n = 0; n < unordered.size(); ++n)
    unordered[n]->axes = *rule_.axes_of(unordered[n]->range, {extents[n], extents[n]});
}

// Of wholes the box tells it, of points that have one integer on each axis a lossless map.
bool NodeAxes::in_one_place(const Node& node, const geometry::Box& wholes) const {
  const QBounds& bounds = node.points.bounds;
  if (!node.wholes.empty() && !bounds.empty()) return false;
  if (node.points.one_place.all) return true;
  for (std::size_t a = 0; a < at(particles_.dims); ++a)
    if (bounds.empty() ? wholes.lo[a] != wholes.hi[a] : !maps_[a].lossless() || bounds.lo[a] != bounds.hi[a])
      return false;
  return true;
}

Extents NodeAxes::extents_of(const Node& node, const geometry::Box& wholes) const {
  Extents extents;
  const QBounds& bounds = node.points.bounds;
  for (std::size_t a = 0; a < at(particles_.dims); ++a) {
    // lo and hi: intervals that hold the least and the greatest coordinate.
    std::array<double, 2> lo{wholes.lo[a], wholes.lo[a]};
    std::array<double, 2> hi{wholes.hi[a], wholes.hi[a]};
    if (!bounds.empty()) {
      const AxisMap& map = maps_[a];
      lo = {std::min(lo[0], map.least(bounds.lo[a])), std::min(lo[1], map.most(bounds.lo[a]))};
      hi = {std::max(hi[0], map.least(bounds.hi[a])), std::max(hi[1], map.most(bounds.hi[a]))};
    }
    extents.least[a] = std::max(geometry::extent(lo[1], hi[0]), 0.0);
    extents.most[a] = geometry::extent(lo[0], hi[1]);
  }
  return extents;
}

// Only the points at a bound are looked at.
void NodeAxes::measure_own(const Node& node, std::span<std::uint64_t> least) {
  const QBounds& bounds = node.points.bounds;
  const auto& where = node.points.one_place.where;
  bool place_read = false;
  for (const Segment& segment : node.segments) {
    cost_.bytes += segment.size() * sizeof(QuantisedPoint);
    for (const QuantisedPoint& point : segment.all()) {
      if (where && point.q == *where && std::exchange(place_read, true)) continue;
      for (std::size_t a = 0; a < at(particles_.dims); ++a) {
        if (point.q[a] != bounds.lo[a] && point.q[a] != bounds.hi[a]) continue;
        const std::uint64_t bits = geometry::order_bits(particles_.position[a][segment.base + point.index]);
        least[2 * a] = std::min(least[2 * a], bits);
        least[2 * a + 1] = std::min(least[2 * a + 1], ~bits);
      }
    }
  }
}

std::vector<Point> NodeAxes::measure(std::span<Node* const> nodes) {
  const std::size_t words = 2 * at(particles_.dims);
  std::vector<std::uint64_t> least(nodes.size() * words, ~std::uint64_t{0});
  for (std::size_t n = 0; n < nodes.size(); ++n) measure_own(*nodes[n], std::span(least).subspan(n * words, words));
  cost_.reductions += comm::all_min_in_messages(comm_, least);
  std::vector<Point> extents(nodes.size());
  for (std::size_t n = 0; n < nodes.size(); ++n) {
    const geometry::Box wholes = box_of(buckets_, nodes[n]->wholes);
    bool one_place = nodes[n]->wholes.empty();
    for (std::size_t a = 0; a < at(particles_.dims); ++a) {
      const std::uint64_t lo = least[n * words + 2 * a];
      const std::uint64_t hi = ~least[n * words + 2 * a + 1];
      one_place = one_place && lo == hi;
      extents[n][a] = geometry::extent(std::min(geometry::value_of_order_bits(lo), wholes.lo[a]),
                                       std::max(geometry::value_of_order_bits(hi), wholes.hi[a]));
    }
    nodes[n]->points.one_place.all = one_place;
  }
  return extents;
}

}  // namespace rcb::partition
