// The particles of one rank: one plain array per axis, always ids, weights only if the scene has them.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "common/base/buffer.hpp"
#include "common/geometry/axes.hpp"

namespace rcb::particles {

using Id = std::int64_t;  // 0 .. 2^63-1

// Coordinates by axis.
using Axes = std::array<const double*, geometry::kDimsMax>;

// A view of particles stored elsewhere. All arrays have `count` entries, but `id` where `id_slot` isn't null.
struct ParticleView {
  int dims = 3;
  std::size_t count = 0;
  Axes position{};  // axes >= dims are null
  const Id* id = nullptr;
  const std::uint64_t* id_slot = nullptr;  // where each particle's id stands in `id`; null: in order
  const double* weight = nullptr;          // null: all weights are 1

  const Id& id_of(std::size_t i) const { return id[id_slot == nullptr ? i : id_slot[i]]; }
  geometry::Point point(std::size_t i) const {
    geometry::Point p{};
    for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a) p[a] = position[a][i];
    return p;
  }
  // The positions from particle `first` on; axes >= dims repeat the first one.
  Axes all_axes(std::size_t first = 0) const {
    Axes x;
    for (std::size_t a = 0; a < x.size(); ++a) x[a] = position[a < static_cast<std::size_t>(dims) ? a : 0] + first;
    return x;
  }
};

struct ParticleSet {
  int dims = 3;
  bool has_weights = false;
  std::array<Buffer<double>, geometry::kDimsMax> position;
  Buffer<Id> id;
  Buffer<double> weight;

  std::size_t count() const { return id.size(); }
  void resize(std::size_t count) {
    for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a) position[a].resize(count);
    id.resize(count);
    if (has_weights) weight.resize(count);
  }
  ParticleView view() const {
    ParticleView v;
    v.dims = dims;
    v.count = count();
    for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a) v.position[a] = position[a].data();
    v.id = id.data();
    v.weight = has_weights ? weight.data() : nullptr;
    return v;
  }
};

}  // namespace rcb::particles
