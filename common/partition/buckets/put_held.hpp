// PutHeld: the pass where cuts are in force. A particle strictly inside of its part's inner region, which no expected
// new cut reaches, is held: it is in its part's bucket, and nothing is written. The others, which are few, are listed:
// the splitters tell their buckets, and their points are made.
//
// A part's box grows with the particles that are held. Almost all particles lie in their part's box as it is already,
// and this one comparison shows that they are held, since the box lies in the inner region; only the others are looked
// at one by one.
#pragma once

#include <optional>
#include <span>

#include "common/partition/buckets/pass.hpp"
#include "common/partition/sample/guide.hpp"

namespace rcb::partition {

// Local particles whose part changes.
struct PartDelta {
  Buffer<std::uint64_t> slot;  // ascending
  Buffer<std::int32_t> part;   // the new one

  void resize(std::size_t count) {
    slot.resize(count);
    part.resize(count);
  }
};

class PutHeld {
 public:
  // scale: of the weights, if they count.
  PutHeld(const particles::ParticleView& particles, const CurrentPartition& current, const GuideFromCuts& guide,
          const AxisMaps& maps, const std::optional<ExactScale>& scale, const Tuning& tuning, PointStore& points);

  // The pass, given up where it lists more than `most` particles. Reads every position once, except in blocks whose
  // ranges show that all their particles are held. Local.
  OwnShare run(std::size_t most);
  // Makes the points of these buckets, which are parts, and lists their particles; returns what it learns of the maps.
  // Local.
  Lossless make(std::span<const std::int32_t> buckets);
  // Which particles change their part, once each bucket's part is known (negative: its points tell). Local.
  PartDelta changes(std::span<const std::int32_t> part_of_bucket, std::span<const PointsOfPart> of_points);

 private:
  // Those of a block that aren't held; the boxes of parts grow by the others.
  std::uint64_t not_held(std::size_t first, Blocks& blocks, std::span<Bounds> boxes) const;
  bool block_is_held(std::size_t first, std::int32_t part, Bounds& box) const;
  std::size_t size_of_block(std::size_t first) const { return std::min(kBlock, particles_.count - first); }
  // Lists particles of a block that aren't listed yet.
  void list(std::size_t first, std::uint64_t which);

  const particles::ParticleView& particles_;
  const CurrentPartition& current_;
  const GuideFromCuts& guide_;
  const AxisMaps& maps_;
  const std::optional<ExactScale>& scale_;
  const Tuning& tuning_;
  PointStore& points_;
  std::vector<Bounds> inner_;          // [parts] the inner regions, as closed boxes
  std::vector<std::uint64_t> listed_;  // [blocks] a bit for each particle
  std::size_t count_ = 0;              // of those listed
};

}  // namespace rcb::partition
