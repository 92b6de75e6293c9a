#include "common/partition/search/part_writer.hpp"

#include <algorithm>

#include "common/base/index.hpp"
#include "common/partition/search/buckets.hpp"

namespace rcb::partition {

void PartWriter::use_buckets(std::span<const std::uint8_t> bucket, std::size_t chunk_max) {
  bucket_ = bucket;
  chunk_max_ = chunk_max;
  part_of_bucket_.assign(((bucket.size() + chunk_max - 1) / chunk_max) * kBuckets, 0);
}

void PartWriter::note(const Span& span, std::span<const QuantisedPoint> points, std::int32_t part) {
  if (span.bucket != Span::kNoBucket && points.size() == span.size())
    part_of_bucket_[span.base / chunk_max_ * kBuckets + at(span.bucket)] = part;
  else
    noted_.push_back({points, span.base, part});
}

std::uint64_t PartWriter::write(std::span<std::int32_t> part) const {
  for (std::size_t first = 0; first < bucket_.size(); first += chunk_max_) {
    const std::int32_t* const part_of = &part_of_bucket_[first / chunk_max_ * kBuckets];
    const std::size_t last = std::min(first + chunk_max_, bucket_.size());
    for (std::size_t i = first; i < last; ++i) part[i] = part_of[bucket_[i]];
  }
  std::uint64_t bytes = bucket_.size() * (sizeof(bucket_[0]) + sizeof(part[0]));
  for (const Noted& own : noted_) {
    for (const QuantisedPoint& point : own.points) part[own.base + point.index] = own.part;
    bytes += own.points.size() * (sizeof(QuantisedPoint) + sizeof(part[0]));
  }
  return bytes;
}

}  // namespace rcb::partition
