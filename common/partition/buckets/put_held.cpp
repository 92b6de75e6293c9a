#include "common/partition/buckets/put_held.hpp"

#include <bit>
#include <cmath>

#include "common/base/index.hpp"

namespace rcb::partition {

PutHeld::PutHeld(const particles::ParticleView& particles, const CurrentPartition& current, const GuideFromCuts& guide,
                 const AxisMaps& maps, const std::optional<ExactScale>& scale, const Tuning& tuning, PointStore& points)
    : particles_(particles),
      current_(current),
      guide_(guide),
      maps_(maps),
      scale_(scale),
      tuning_(tuning),
      points_(points),
      listed_(particles::blocks_of(particles.count)) {
  for (const geometry::Box& region : guide.inner) {
    Bounds& inner = inner_.emplace_back(Bounds::of(region, particles.dims));
    for (std::size_t a = 0; a < at(particles.dims); ++a) {
      inner.lo[a] = std::nextafter(inner.lo[a], Bounds::kInfinity);
      inner.hi[a] = std::nextafter(inner.hi[a], -Bounds::kInfinity);
    }
  }
}

void PutHeld::list(std::size_t first, std::uint64_t which) {
  listed_[first / kBlock] |= which;
  count_ += at(std::popcount(which));
}

bool PutHeld::block_is_held(std::size_t first, std::int32_t part, Bounds& box) const {
  if (current_.blocks == nullptr) return false;
  const auto range_on = [&](std::size_t a) { return current_.blocks->of[a][first / kBlock]; };
  const Bounds& inner = inner_[at(part)];
  for (std::size_t a = 0; a < at(particles_.dims); ++a)
    if (!(range_on(a).lo >= inner.lo[a] && range_on(a).hi <= inner.hi[a])) return false;
  box.extend(at(particles_.dims), range_on);
  return true;
}

std::uint64_t PutHeld::not_held(std::size_t first, Blocks& blocks, std::span<Bounds> boxes) const {
  const std::int32_t* part = current_.part.data() + first;
  BucketsOfBlock filled;
  if (size_of_block(first) < kBlock) {  // as Blocks does
    filled.fill(part[0]);
    std::copy_n(part, size_of_block(first), filled.begin());
    part = filled.data();
  }
  std::int32_t other = 0;
  for (std::size_t i = 0; i < kBlock; ++i) other |= part[i] ^ part[0];
  const bool one_part = other == 0;
  if (one_part && block_is_held(first, part[0], boxes[at(part[0])])) return 0;
  const Axes& x = blocks.read(first);
  std::uint64_t beyond =
      one_part ? kernels().outside(x, boxes[at(part[0])]) : kernels().outside_own(x, part, boxes.data());
  std::uint64_t out = 0;
  for (; beyond != 0; beyond &= beyond - 1) {  // mostly few
    const auto i = at(std::countr_zero(beyond));
    const Bounds& inner = inner_[at(part[i])];
    bool inside = true;
    for (std::size_t a = 0; a < x.size(); ++a) inside &= (x[a][i] >= inner.lo[a]) & (x[a][i] <= inner.hi[a]);
    out |= std::uint64_t{!inside} << i;
    if (inside)
      boxes[at(part[i])].extend(at(particles_.dims), [&](std::size_t a) { return particles::Range{x[a][i], x[a][i]}; });
  }
  return out;
}

OwnShare PutHeld::run(std::size_t most) {
  const std::size_t parts = at(current_.tree.parts);
  OwnShare own(Splitters::kBuckets + parts, particles_.dims);
  own.leaving.resize(parts + 1);
  const WalkTables tables(guide_.guide.splitters);
  const std::span<Bounds> boxes = std::span(own.boxes).subspan(Splitters::kBuckets);
  Blocks some(particles_);
  // Where ranges are known, blocks that are held as a whole soon make the boxes grow.
  if (current_.blocks == nullptr)
    for_seeds(particles_.count, [&](std::size_t first) { (void)not_held(first, some, boxes); });
  const auto choose = [&](std::size_t first, Blocks& blocks, BucketsOfBlock&) {
    if (count_ > most) return std::uint64_t{0};
    const std::uint64_t which = not_held(first, blocks, boxes) & blocks.present(first);
    if (which != 0) list(first, which);
    return which;
  };
  const auto place = [&](const Axes& x, const std::uint32_t* own_index, std::int32_t* bucket, std::uint64_t which) {
    kernels().walk(tables, x, bucket);
    own.grow(x, bucket, kernels().outside_own(x, bucket, own.boxes.data()) & which);
    for (; which != 0; which &= which - 1) {
      const std::size_t k = at(std::countr_zero(which));
      const std::size_t slot = points_.base() + own_index[k];
      const Load load{1, scale_ ? (*scale_)(particles_.weight[slot]) : u128{0}};
      own.loads[at(bucket[k])] += load;
      own.leaving[at(current_.part[slot])] += load;
    }
  };
  own.lossless = make_points(particles_, maps_, tuning_, points_, choose, place);
  own.leaving[parts].count = count_ > most ? 1 : 0;
  return own;
}

Lossless PutHeld::make(std::span<const std::int32_t> buckets) {
  std::vector<std::uint8_t> is_wanted(at(current_.tree.parts), 0);
  for (const std::int32_t b : buckets) is_wanted[at(b) - Splitters::kBuckets] = 1;
  const auto choose = [&](std::size_t first, Blocks& blocks, BucketsOfBlock& bucket) {
    std::uint64_t which = 0;
    for (std::size_t i = 0; i < size_of_block(first); ++i) {
      const std::int32_t part = current_.part[first + i];
      which |= std::uint64_t{is_wanted[at(part)]} << i;
      bucket[i] = part + static_cast<std::int32_t>(Splitters::kBuckets);
    }
    which &= ~listed_[first / kBlock];
    if (which == 0) return which;
    blocks.read(first);
    list(first, which);
    return which;
  };
  return make_points(particles_, maps_, tuning_, points_, choose, [](auto&&...) {});
}

PartDelta PutHeld::changes(std::span<const std::int32_t> part_of_bucket, std::span<const PointsOfPart> of_points) {
  // The new parts of particles that stayed held: mostly all keep theirs.
  std::vector<std::int32_t> moved(at(current_.tree.parts));
  bool any_moved = false;
  for (std::size_t p = 0; p < moved.size(); ++p) {
    const std::int32_t to = part_of_bucket[Splitters::kBuckets + p];
    moved[p] = to < 0 ? static_cast<std::int32_t>(p) : to;
    any_moved |= at(moved[p]) != p;
  }
  for (std::size_t first = 0; first < particles_.count && any_moved; first += kBlock) {
    std::uint64_t which = 0;
    for (std::size_t i = 0; i < size_of_block(first); ++i) {
      const std::int32_t part = current_.part[first + i];
      which |= std::uint64_t{moved[at(part)] != part} << i;
    }
    list(first, which & ~listed_[first / kBlock]);
  }
  const auto for_listed = [&](const auto& visit) {
    constexpr std::size_t kAhead = 16;  // blocks; their parts are no longer at hand
    for (std::size_t b = 0; b < listed_.size(); ++b) {
      for (std::size_t i = 0; i < kBlock; i += 16) prefetch(current_.part.data(), (b + kAhead) * kBlock + i);
      for (std::uint64_t left = listed_[b]; left != 0; left &= left - 1) visit(b * kBlock + at(std::countr_zero(left)));
    }
  };
  // Their new parts in the order of their slots, of which the points know nothing. Those without a point have moved.
  Buffer<std::int32_t> now(count_);
  std::vector<std::uint64_t> before;  // how many stand before each block
  std::size_t listed = 0;
  for (const std::uint64_t block : listed_) {
    before.push_back(listed);
    listed += at(std::popcount(block));
  }
  listed = 0;
  if (any_moved) for_listed([&](std::size_t slot) { now[listed++] = moved[at(current_.part[slot])]; });
  for (const PointsOfPart& own : of_points)
    for (const QuantisedPoint& point : own.points) {
      const std::size_t slot = own.base + point.index;
      const std::uint64_t below = listed_[slot / kBlock] & ((std::uint64_t{1} << (slot % kBlock)) - 1);
      now[before[slot / kBlock] + at(std::popcount(below))] = own.part;
    }
  PartDelta delta;
  delta.resize(count_ + 1);  // what hasn't changed is written behind the last, too: without a branch
  std::size_t told = 0;
  listed = 0;
  for_listed([&](std::size_t slot) {
    delta.slot[told] = slot;
    delta.part[told] = now[listed++];
    told += delta.part[told] == current_.part[slot] ? 0U : 1U;
  });
  delta.resize(told);
  return delta;
}

}  // namespace rcb::partition
