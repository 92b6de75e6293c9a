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

#include "common/partition/buckets/listed.hpp"
#include "common/partition/buckets/pass.hpp"
#include "common/partition/sample/guide_from_cuts.hpp"

namespace rcb::partition {

// The boxes of a rank's own parts. Parts of other ranks share the last one, which stays empty.
class OwnBoxes {
 public:
  // inner: [own parts] inner regions, open boxes
  OwnBoxes(OwnParts own, std::span<const geometry::Box> inner, int dims);

  // Among these boxes. As an unsigned number a part below the first one is great, too: another rank's.
  std::int32_t index_of(std::int32_t part) const {
    return static_cast<std::int32_t>(std::min(static_cast<std::uint32_t>(part - first_), others_));
  }
  // Of a block whose particles have these indices, or all this one, those that aren't held; the boxes grow with the
  // others.
  std::uint64_t not_held(const Axes& x, const BucketsOfBlock& index);
  std::uint64_t not_held(const Axes& x, std::int32_t index);
  // True if these ranges show that all particles of a block are held; then the box grows by the block.
  bool hold_block(const particles::BlockRanges& ranges, std::size_t block, std::int32_t index);
  // Sets boxes[first own part ...]
  void copy_to(std::span<Bounds> boxes_of_parts) const;

 private:
  template <typename IndexOf>
  std::uint64_t hold(const Axes& x, std::uint64_t beyond, const IndexOf& index_of);

  std::int32_t first_;
  std::uint32_t others_;
  std::size_t dims_;
  std::vector<Bounds> inner_;  // [own parts + 1], closed
  std::vector<Bounds> boxes_;  // [own parts + 1]
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
  Lossless make(std::span<const std::int32_t> wanted);
  // Lists all particles of parts that `moved` gives another part. Local.
  void list_moved(std::span<const std::int32_t> moved);
  const Listed& listed() const { return listed_; }

 private:
  const particles::ParticleView& particles_;
  const CurrentPartition& current_;
  const GuideFromCuts& guide_;
  const AxisMaps& maps_;
  const std::optional<ExactScale>& scale_;
  const Tuning& tuning_;
  PointStore& points_;
  Listed listed_;
};

}  // namespace rcb::partition
