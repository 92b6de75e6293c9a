// BoundaryList: the boundary particles of a pass, copied while their positions are in the cache.
#pragma once

#include <array>
#include <cstdint>

#include "common/partition/incremental/classify_interior.hpp"

namespace rcb::partition {

using particles::Axes;

class BoundaryList {
 public:
  // part: of each particle; room: about how many are expected.
  BoundaryList(const particles::ParticleView& particles, const std::int32_t* part, std::size_t room, OwnInterior& out);

  std::size_t size() const { return size_; }
  // Appends those particles of a block whose bits are set in `which`. slot: of its first particle.
  void append(std::size_t slot, std::uint64_t which);
  // After the last block. Copies weights, too, unless there are more than `most`: only now, to keep these scattered
  // reads out of the pass.
  void finish(std::size_t most);

 private:
  void copy();
  void resize(std::size_t count);

  Axes x_;
  const double* weight_;
  const std::int32_t* part_;
  OwnInterior& out_;  // whose arrays are longer than size_ until finish()
  std::size_t size_ = 0;
  std::size_t copied_ = 0;
};

}  // namespace rcb::partition
