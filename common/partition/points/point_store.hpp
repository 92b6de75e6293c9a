// PointStore: a rank's quantised points by bucket, in blocks that are appended to; and PointMaker, which fills it.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/partition/kernels/kernels.hpp"
#include "common/partition/points/axis_map.hpp"
#include "common/partition/points/segment.hpp"
#include "common/partition/rules/tuning.hpp"

namespace rcb::partition {

class PointStore {
 public:
  // block: room for so many points is made at once.
  PointStore(std::size_t buckets, std::size_t block) : tails_(buckets), segments_(buckets), block_(block) {}

  // Those of a block whose bits are set.
  void append(const QuantisedPoint* points, const std::int32_t* bucket, std::uint64_t which);
  // Points appended from here on are of particles base + index.
  void begin_chunk(std::uint64_t base);
  std::uint64_t base() const { return base_; }
  // The points of a bucket that weren't taken yet.
  std::uint64_t count(std::size_t bucket) const;
  // Their segments, whose bounds aren't known yet. They stay valid as long as this.
  std::vector<Segment> take(std::size_t bucket);

 private:
  struct Tail {  // the rest of a bucket's last block
    QuantisedPoint* next = nullptr;
    QuantisedPoint* end = nullptr;
  };

  void extend(std::size_t bucket);
  void close(std::size_t bucket);

  std::vector<Buffer<QuantisedPoint>> blocks_;
  std::vector<Tail> tails_;                     // [buckets]
  std::vector<std::vector<Segment>> segments_;  // [buckets]; the last one of each ends where its tail begins
  std::size_t block_;
  std::uint64_t base_ = 0;
};

// How many points of a bucket to make room for at once, of `count` particles in so many buckets. Local.
std::size_t points_together(std::uint64_t count, std::size_t buckets, const Tuning& tuning);

// Chosen particles, side by side, until there are enough for a block.
struct Batch {
  static constexpr std::size_t kRoom = 2 * kBlock;
  std::array<std::array<double, kRoom>, geometry::kDimsMax> x;
  std::array<std::uint32_t, kRoom> index;  // in their chunk
  std::array<std::int32_t, kRoom> bucket;
  std::size_t size = 0;

  // Those of a block whose bits are set in `which`.
  //   first  index of the block's first particle; bucket: [kBlock]
  void add(std::uint32_t first, const Axes& from, std::uint64_t which, const std::int32_t* bucket_of);
  // The first ones as a block, filled up with copies; one bit for each of them.
  Axes block();
  std::uint64_t present() const { return size < kBlock ? (std::uint64_t{1} << size) - 1 : ~std::uint64_t{0}; }
  // Takes out the first block.
  void drop();
};

// Makes quantised points.
class PointMaker {
 public:
  // check: whether the maps are lossless is to be found out (only where all are by value).
  PointMaker(const AxisMaps& maps, int dims, bool check, PointStore& store);

  // Of those particles of a block whose bits are set.
  //   index, bucket  [kBlock]
  void make(const Axes& x, const std::uint32_t* index, const std::int32_t* bucket, std::uint64_t which);
  const Lossless& lossless() const { return lossless_; }

 private:
  const AxisMaps& maps_;
  std::size_t dims_;
  bool linear_;
  bool check_;
  LinearMaps by_value_;
  PointStore& store_;
  Lossless lossless_;
};

}  // namespace rcb::partition
