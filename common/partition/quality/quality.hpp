// Room `quality`: what a partition costs a solver: ghosts, neighbours, interfaces. Nothing else depends on it.
//
// Partition quality, computed only when asked: interface area, neighbours, ghosts.
//
// Ghosts and neighbours: for each part, how many particles of other parts lie near its particles' bounding box, and how
// many parts own them. They are found by a tree of the boxes: a particle that is near all boxes of a subtree is counted
// there once, for all of its parts, so the widest ghosts cost no more than narrow ones.
//
// Memory beyond a few numbers per part is bounded, however many pairs of parts are neighbours: all ranks take the
// owners of particles in one order, and what is known of an owner is summed up and dropped once all ranks have looked
// at its particles.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "common/comm/comm.hpp"
#include "common/cuts/cut_tree.hpp"
#include "common/geometry/box.hpp"
#include "common/particles/particle_set.hpp"

namespace rcb::partition {

using cuts::CutTree;

struct GhostCounts {
  // Per part: particles of other parts within the width (maximum norm) of the box of its particles.
  std::vector<std::uint64_t> ghosts;
  std::vector<std::int32_t> neighbours;  // per part: how many parts own those
};

struct GhostLimits {
  std::uint64_t round_visits = std::uint64_t{1} << 21U;  // boxes looked at between two calls of go_on
  std::size_t pending_max = std::size_t{1} << 19U;       // ranges of parts that a rank keeps while other ranks catch up
};

// The bounding box of each part's particles, on all ranks; empty for a part without any. Collective (one reduction).
//   part  [particles.count], 0 .. parts - 1
std::vector<geometry::Box> part_boxes(comm::Comm& comm, const particles::ParticleView& particles,
                                      std::span<const std::int32_t> part, int parts);

// nullopt if go_on said no. Collective.
//   part   [particles.count]
//   boxes  of all parts
std::optional<GhostCounts> count_ghosts(comm::Comm& comm, const particles::ParticleView& particles,
                                        std::span<const std::int32_t> part, std::vector<geometry::Box> boxes,
                                        double width, const comm::GoOn& go_on, const GhostLimits& limits = {});

struct Quality : GhostCounts {
  double ghost_width = 0;
  geometry::Box bounds;                     // of all particles
  std::optional<double> interface_area;     // common faces of regions clipped to `bounds`; nullopt without
                                            // a cut tree. In 2-D a length, in 1-D a number of points. A face
                                            // between two parts counts once here and once for each of them below
  std::vector<double> part_interface_area;  // per part; empty without a cut tree
};

// 2 * (box volume / n)^(1/dims) over the axes of positive extent; 0 with no particles. Local.
double default_ghost_width(const geometry::Box& bounds, std::uint64_t n, int dims);

// Collective. nullopt if go_on said no.
//   part   [particles.count]
//   tree   null for methods without regions
//   ghost_width  >= 0; nullopt: the default
std::optional<Quality> quality(comm::Comm& comm, const particles::ParticleView& particles,
                               std::span<const std::int32_t> part, int parts, const CutTree* tree,
                               std::optional<double> ghost_width, const comm::GoOn& go_on);

}  // namespace rcb::partition
