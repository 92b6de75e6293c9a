// Listed: some of a rank's particles, one bit each.
#pragma once

#include <cstdint>
#include <span>

#include "common/base/buffer.hpp"
#include "common/partition/kernels/block.hpp"

namespace rcb::partition {

// Local particles whose part changes.
struct PartDelta {
  Buffer<std::uint64_t> slot;  // ascending
  Buffer<std::int32_t> part;   // the new one
};

// Points that all end in one part.
struct PointsOfPart {
  std::span<const QuantisedPoint> points;
  std::uint64_t base;  // particle base + index is this rank's particle of that index
  std::int32_t part;
};

class Listed {
 public:
  explicit Listed(std::size_t particles);

  std::size_t count() const { return count_; }
  std::uint64_t of_block(std::size_t block) const { return bits_[block]; }
  // Those of a block whose bits are set; none of them is listed.
  void add(std::size_t block, std::uint64_t which);
  // Those listed whose new part isn't the one they have. Local.
  //   part     of each particle, now; moved: [parts] the new part of those that no point tells of
  //   of_points  the new parts of the others
  PartDelta changes(std::span<const std::int32_t> part, std::span<const std::int32_t> moved,
                    std::span<const PointsOfPart> of_points) const;

 private:
  Buffer<std::uint64_t> bits_;  // [blocks]
  std::size_t count_ = 0;
};

}  // namespace rcb::partition
