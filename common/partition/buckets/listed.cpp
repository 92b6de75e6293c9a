#include "common/partition/buckets/listed.hpp"

#include <algorithm>
#include <bit>

#include "common/base/index.hpp"

namespace rcb::partition {

Listed::Listed(std::size_t particles) : bits_(particles::blocks_of(particles)) {
  std::fill(bits_.begin(), bits_.end(), std::uint64_t{0});
}

void Listed::add(std::size_t block, std::uint64_t which) {
  bits_[block] |= which;
  count_ += at(std::popcount(which));
}

PartDelta Listed::changes(std::span<const std::int32_t> part, std::span<const std::int32_t> moved,
                          std::span<const PointsOfPart> of_points) const {
  // Their new parts in the order of their slots, of which the points know nothing.
  Buffer<std::int32_t> now(count_);
  Buffer<std::uint64_t> before(bits_.size());  // how many stand before each block
  std::size_t listed = 0;
  for (std::size_t b = 0; b < bits_.size(); ++b) {
    before[b] = listed;
    for (std::uint64_t left = bits_[b]; left != 0; left &= left - 1)
      now[listed++] = moved[at(part[b * kBlock + at(std::countr_zero(left))])];
  }
  for (const PointsOfPart& own : of_points)
    for (const QuantisedPoint& point : own.points) {
      const std::size_t slot = own.base + point.index;
      const std::uint64_t below = bits_[slot / kBlock] & ((std::uint64_t{1} << (slot % kBlock)) - 1);
      now[before[slot / kBlock] + at(std::popcount(below))] = own.part;
    }
  PartDelta delta;
  delta.slot.resize(count_ + 1);  // what hasn't changed is written behind the last, too: without a branch
  delta.part.resize(count_ + 1);
  std::size_t told = 0;
  listed = 0;
  for (std::size_t b = 0; b < bits_.size(); ++b)
    for (std::uint64_t left = bits_[b]; left != 0; left &= left - 1) {
      const std::size_t slot = b * kBlock + at(std::countr_zero(left));
      delta.slot[told] = slot;
      delta.part[told] = now[listed++];
      told += delta.part[told] == part[slot] ? 0U : 1U;
    }
  delta.slot.resize(told);
  delta.part.resize(told);
  return delta;
}

}  // namespace rcb::partition
