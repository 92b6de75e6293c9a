// The kernels. Each takes a block: 64 readable coordinates on each of three axes (axes >= dims repeat the first one, as
// in ParticleView::all_axes()); a caller fills up an incomplete block with copies of a particle.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "common/base/cpu.hpp"
#include "common/partition/kernels/block.hpp"

namespace rcb::partition {

// A level's nodes as vectors of floats. Place p belongs to the node whose number is p modulo their number, so that the
// low bits of a node's number find it in a table of any length.
struct alignas(64) LevelTable {
  static constexpr std::size_t kPlaces = std::size_t{1} << (Splitters::kLevels - 1);
  std::array<float, kPlaces> least;
  std::array<float, kPlaces> most;
  std::array<std::uint32_t, geometry::kDimsMax> on{};  // by axis: bit p: it is that of place p
};
struct WalkTables {
  explicit WalkTables(const Splitters& splitters);
  std::array<LevelTable, Splitters::kLevels> levels;
  RoundedAxes rounded;
};

struct Kernels {
  // bucket[i] becomes the number of the first node, on the way down, where particle i may lie on either side of the
  // cut; if there is none, that of its leaf.
  void (*walk)(const WalkTables& tables, const Axes& x, std::int32_t* bucket);
  // Bit i: particle i lies outside of boxes[bucket[i]].
  std::uint64_t (*outside_own)(const Axes& x, const std::int32_t* bucket, const Bounds* boxes);
  // Bit i: particle i lies outside of the box.
  std::uint64_t (*outside)(const Axes& x, const Bounds& box);
  // Makes the quantised points of the particles, with these indices.
  //   lossless  what it learns is added here; null: nothing
  void (*quantise)(const Axes& x, const std::uint32_t* index, const LinearMaps& maps, QuantisedPoint* points,
                   Lossless* lossless);
  // Makes the bounds hold these points, too.
  void (*widen)(QBounds& bounds, std::span<const QuantisedPoint> points);
};

// Those for an instruction set that the processor has; by default the one that is to be used.
const Kernels& kernels(InstructionSet set = instruction_set());

}  // namespace rcb::partition
