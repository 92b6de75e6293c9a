// NodeAxes: the order of the axes of a level's nodes, by their exact extents. Where the integers of their points leave
// the order open, coordinates decide.
#pragma once

#include <span>
#include <vector>

#include "common/partition/rules/split_rule.hpp"
#include "common/partition/search/node.hpp"

namespace rcb::partition {

class NodeAxes {
 public:
  NodeAxes(comm::Comm& comm, const particles::ParticleView& particles, const AxisMaps& maps,
           std::span<const Bucket> buckets, const SplitRule& rule, SearchCost& cost)
      : comm_(comm), particles_(particles), maps_(maps), buckets_(buckets), rule_(rule), cost_(cost) {}

  // Sets the axes of nodes that have particles, and finds out whose points lie in one place. Collective (one minimum at
  // most).
  void order(std::span<Node> nodes);

 private:
  // True if all particles are known to lie in one place.
  bool in_one_place(const Node& node, const geometry::Box& wholes) const;
  Extents extents_of(const Node& node, const geometry::Box& wholes) const;
  // The exact extents of these nodes. Collective (one minimum).
  std::vector<Point> measure(std::span<Node* const> nodes);
  // The box of this rank's points, as far as it matters to that of all ranks' ones. Local.
  geometry::Box measure_own(const Node& node);

  comm::Comm& comm_;
  const particles::ParticleView& particles_;
  const AxisMaps& maps_;
  std::span<const Bucket> buckets_;
  const SplitRule& rule_;
  SearchCost& cost_;
};

}  // namespace rcb::partition
