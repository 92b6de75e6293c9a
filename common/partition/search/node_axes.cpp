#include "common/partition/search/node_axes.hpp"

#include <algorithm>

#include "common/base/index.hpp"
#include "common/partition/balance/bounds.hpp"

namespace rcb::partition {

void NodeAxes::order(std::span<Node> nodes) {
  std::vector<Node*> unordered;
  for (Node& node : nodes) {
    const geometry::Box wholes = box_of(buckets_, node.wholes);
    node.points.one_place = in_one_place(node, wholes);
    if (const auto axes = rule_.axes_of(node.range, node.points.one_place ? Extents{} : extents_of(node, wholes)))
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
  if (node.points.one_place) return true;
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
geometry::Box NodeAxes::measure_own(const Node& node) {
  const QBounds& bounds = node.points.bounds;
  geometry::Box box;
  for (const Segment& segment : node.segments) {
    cost_.bytes += segment.size() * sizeof(QuantisedPoint);
    for (const QuantisedPoint& point : segment.all()) {
      for (std::size_t a = 0; a < at(particles_.dims); ++a) {
        if (point.q[a] != bounds.lo[a] && point.q[a] != bounds.hi[a]) continue;
        const double x = particles_.position[a][segment.base + point.index];
        box.lo[a] = std::min(box.lo[a], x);
        box.hi[a] = std::max(box.hi[a], x);
      }
    }
  }
  return box;
}

std::vector<Point> NodeAxes::measure(std::span<Node* const> nodes) {
  AllMinMax all;
  for (const Node* node : nodes) all.add(measure_own(*node), particles_.dims);
  cost_.reductions += all.reduce(comm_);
  std::vector<Point> extents(nodes.size());
  for (std::size_t n = 0; n < nodes.size(); ++n) {
    geometry::Box box;
    all.take(box, particles_.dims);
    bool one_place = nodes[n]->wholes.empty();
    for (std::size_t a = 0; a < at(particles_.dims); ++a) one_place = one_place && box.lo[a] == box.hi[a];
    nodes[n]->points.one_place = one_place;
    box.extend(box_of(buckets_, nodes[n]->wholes));
    extents[n] = box.extents(particles_.dims);
  }
  return extents;
}

}  // namespace rcb::partition
