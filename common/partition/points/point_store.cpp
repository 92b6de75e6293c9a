#include "common/partition/points/point_store.hpp"

#include <algorithm>
#include <bit>
#include <utility>

#include "common/base/index.hpp"

namespace rcb::partition {

void PointStore::close(std::size_t bucket) {
  Tail& tail = tails_[bucket];
  std::vector<Segment>& own = segments_[bucket];
  if (tail.next == nullptr) return;
  own.back().last = tail.next;
  if (own.back().size() == 0) own.pop_back();
  tail = {};
}

void PointStore::extend(std::size_t bucket) {
  close(bucket);
  QuantisedPoint* const first = blocks_.emplace_back(block_).data();
  segments_[bucket].push_back({.first = first, .base = base_});
  tails_[bucket] = {first, first + block_};
}

void PointStore::begin_chunk(std::uint64_t base) {
  for (std::size_t b = 0; b < tails_.size(); ++b) close(b);
  base_ = base;
}

std::vector<Segment> PointStore::take(std::size_t bucket) {
  close(bucket);
  return std::exchange(segments_[bucket], {});
}

std::uint64_t PointStore::count(std::size_t bucket) const {
  std::uint64_t count = 0;
  for (const Segment& segment : segments_[bucket])
    count += static_cast<std::uint64_t>((segment.last == nullptr ? tails_[bucket].next : segment.last) - segment.first);
  return count;
}

// Neighbours often share a bucket: its tail is written back only where another one follows, or each point would wait
// for the one before.
void PointStore::append(const QuantisedPoint* points, const std::int32_t* bucket, std::uint64_t which) {
  constexpr std::size_t kAhead = 8;
  std::int32_t current = bucket[std::countr_zero(which)];
  Tail tail = tails_[at(current)];
  for (; which != 0; which &= which - 1) {
    const std::size_t k = at(std::countr_zero(which));
    if (bucket[k] != current) {
      tails_[at(current)] = tail;
      current = bucket[k];
      tail = tails_[at(current)];
    }
    if (tail.next == tail.end) {
      tails_[at(current)] = tail;
      extend(at(current));
      tail = tails_[at(current)];
    }
    prefetch(tail.next, kAhead);  // the processor sees no pattern in so many places
    *tail.next++ = points[k];
  }
  tails_[at(current)] = tail;
}

// A bucket seldom fills its last block: small ones waste less memory, large ones make fewer segments.
std::size_t points_together(std::uint64_t count, std::size_t buckets, const Tuning& tuning) {
  if (buckets > 1) return std::clamp<std::size_t>(std::min(count / 256, 4 * count / buckets), 64, 4096);
  return std::clamp<std::size_t>(count, 1, tuning.chunk_max + kBlock);
}

// Their indices are listed first, eight per step whether or not so many are left: how many steps it takes can be
// predicted, where the bits are can't. What is listed too many is overwritten.
void Batch::add(std::uint32_t first, const Axes& from, std::uint64_t which, const std::int32_t* bucket_of) {
  constexpr std::size_t kTogether = 8;
  std::array<std::uint8_t, kBlock + kTogether> row;
  const std::size_t count = at(std::popcount(which));
  for (std::size_t k = 0; k < count; k += kTogether)
    for (std::size_t i = 0; i < kTogether; ++i, which &= which - 1)
      row[k + i] = static_cast<std::uint8_t>(std::countr_zero(which));
  for (std::size_t a = 0; a < x.size(); ++a)
    for (std::size_t k = 0; k < count; ++k) x[a][size + k] = from[a][row[k]];
  for (std::size_t k = 0; k < count; ++k) {
    index[size + k] = first + row[k];
    bucket[size + k] = bucket_of[row[k]];
  }
  size += count;
}

Axes Batch::block() {
  for (auto& axis : x)
    if (size < kBlock) std::fill(axis.begin() + static_cast<std::ptrdiff_t>(size), axis.begin() + kBlock, axis[0]);
  return {x[0].data(), x[1].data(), x[2].data()};
}

void Batch::drop() {
  const std::size_t rest = size < kBlock ? 0 : size - kBlock;
  for (auto& axis : x) std::copy_n(axis.begin() + kBlock, rest, axis.begin());
  std::copy_n(index.begin() + kBlock, rest, index.begin());
  std::copy_n(bucket.begin() + kBlock, rest, bucket.begin());
  size = rest;
}

PointMaker::PointMaker(const AxisMaps& maps, int dims, bool check, PointStore& store)
    : maps_(maps), dims_(at(dims)), linear_(all_linear(maps, dims)), check_(check), store_(store) {
  for (std::size_t a = 0; a < dims_ && linear_; ++a) {
    by_value_.base[a] = maps[a].half_base();
    by_value_.scale[a] = maps[a].scale();
    by_value_.step[a] = 1 / maps[a].scale();
  }
}

void PointMaker::make(const Axes& x, const std::uint32_t* index, const std::int32_t* bucket, std::uint64_t which) {
  std::array<QuantisedPoint, kBlock> points;
  if (!linear_) {
    for (std::size_t a = 0; a < dims_; ++a)
      for (std::size_t k = 0; k < kBlock; ++k) points[k].q[a] = maps_[a](x[a][k]);
    for (std::size_t k = 0; k < kBlock; ++k) points[k].index = index[k];
  } else {
    kernels().quantise(x, index, by_value_, points.data(), check_ ? &lossless_ : nullptr);
  }
  store_.append(points.data(), bucket, which);
}

}  // namespace rcb::partition
