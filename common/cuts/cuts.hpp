// Room `cuts`: what the cuts of a partition tell without its particles: who owns a position, which particles a part
// needs as halo, which parts are neighbours, where regions are. The service, its clients and solvers share it: it knows
// neither MPI nor sockets.
//
// Cuts: an immutable snapshot of the cuts of one epoch. Copies are cheap and share it. All methods may be called by any
// threads at the same time. Answers depend on the arguments alone: not on hints, threads or the processor.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "common/base/status.hpp"
#include "common/cuts/cut_tree.hpp"
#include "common/cuts/halo.hpp"
#include "common/cuts/periodic.hpp"
#include "common/cuts/positions.hpp"

namespace rcb::cuts {

// Part q is near a part where that part's particles are moved by `shift` periods.
struct Neighbour {
  std::int32_t part = 0;
  Shift shift{};

  bool operator==(const Neighbour&) const = default;
};

// The smallest distance between two opposite faces of a region.
struct Narrowest {
  std::int32_t part = 0;
  int axis = 0;
  double width = 0;
};

struct OwnerTables;

class Cuts {
 public:
  Cuts(CutTree tree, std::uint64_t epoch);

  const CutTree& tree() const;
  int parts() const { return tree().parts; }
  int dims() const { return tree().dims; }
  std::uint64_t epoch() const;
  std::uint64_t hash() const;
  const OwnerTables& tables() const;  // for the passes of this room

  // Sets part[i] to the part that owns position i. Errors: invalid_argument (lengths, dims), not_finite (names the
  // row).
  Status owner(const Positions& positions, const OwnerOptions& options, std::span<std::int32_t> part) const;
  // The rows that each part needs from the particles given, which may be all or one process's. Errors also:
  // invalid_argument (a width or periodic box, more than 65,536 images of a particle), too_large.
  Result<Halo> halo(const Positions& positions, const HaloOptions& options) const;
  // The parts within near.width of this part's region, ascending, each with its shifts, ascending; itself only by moved
  // images. Of particles in the region (along periodic axes also in the box) halo() names no others. With shifts the
  // answers for two parts may differ by a rounding error at their borders.
  Result<std::vector<Neighbour>> neighbours(int part, const Near& near) const;
  // Parts whose region touches the box or one of its images; ascending. Both are closed. Bounds may be infinite.
  Result<std::vector<int>> box(const geometry::Box& box, const PeriodicBox& periodic = {}) const;
  // By part. Infinite where unbounded; empty() for a part that can own no position.
  std::span<const geometry::Box> regions() const;
  // Where no bound is infinite; along periodic axes the box bounds regions that have no bound. nullopt: no such region.
  std::optional<Narrowest> narrowest(const PeriodicBox& periodic = {}) const;

 private:
  struct Data;
  std::shared_ptr<const Data> data_;
};

}  // namespace rcb::cuts
