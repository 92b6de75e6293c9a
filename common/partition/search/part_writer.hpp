// PartWriter: writes the parts of a rank's particles once all are known. The particles of a bucket that was never
// divided follow from the bucket of each, in their order; only those of others are found through their quantised
// points.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/partition/search/quantised_points.hpp"

namespace rcb::partition {

class PartWriter {
 public:
  // Before anything is noted, if there are buckets. bucket: [particles], as in QuantisedPoints::build().
  void use_buckets(std::span<const std::uint8_t> bucket, std::size_t chunk_max);
  // These quantised points of a span belong to this part.
  void note(const Span& span, std::span<const QuantisedPoint> points, std::int32_t part);
  // Sets part[i] of all particles noted; returns the bytes read and written. The buckets may take the last quarter of
  // part's memory: no part is written where the bucket of a later particle stands. Local.
  std::uint64_t write(std::span<std::int32_t> part) const;

 private:
  struct Noted {
    std::span<const QuantisedPoint> points;
    std::uint64_t base;  // the first particle of their chunk
    std::int32_t part;
  };
  std::vector<Noted> noted_;
  std::span<const std::uint8_t> bucket_;
  std::size_t chunk_max_ = 1;
  std::vector<std::int32_t> part_of_bucket_;  // [chunk * kBuckets + bucket]; 0 if it was divided
};

}  // namespace rcb::partition
