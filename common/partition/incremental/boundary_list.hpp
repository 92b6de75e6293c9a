// BoundaryList: the boundary particles of a pass, copied block by block.
#pragma once

#include <array>
#include <cstdint>

#include "common/partition/incremental/classify_interior.hpp"

namespace rcb::partition {

// A block's coordinates; where there are fewer axes, the others repeat the first.
using Axes = std::array<const double*, geometry::kDimsMax>;

Axes axes_of(const particles::ParticleView& particles);

class BoundaryList {
 public:
  explicit BoundaryList(OwnInterior& out) : out_(out) {}

  std::size_t size() const { return size_; }
  // Appends those particles of a block whose bits are set in `which`. slot: of its first particle; part: of each.
  void append(const Axes& x, std::size_t slot, const std::int32_t* part, std::size_t count, std::uint64_t which);
  // After the last block.
  void finish() { resize(size_); }

 private:
  void resize(std::size_t count);

  OwnInterior& out_;  // whose arrays have room for a block more than `size_`
  std::size_t size_ = 0;
};

}  // namespace rcb::partition
