// Room `quality`: what a partition costs a solver: ghosts, neighbours, interfaces. Nothing else depends on it.
//
// Partition quality, computed only when asked: interface area, neighbours, ghosts.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "common/comm/comm.hpp"
#include "common/cuts/cut_tree.hpp"
#include "common/geometry/box.hpp"
#include "common/partition/quality/ghosts.hpp"

namespace rcb::partition {

using cuts::CutTree;

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
