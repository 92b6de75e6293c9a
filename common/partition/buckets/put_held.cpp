#include "common/partition/buckets/put_held.hpp"

#include <bit>
#include <cmath>

#include "common/base/index.hpp"

namespace rcb::partition {

OwnBoxes::OwnBoxes(OwnParts own, std::span<const geometry::Box> inner, int dims)
    : first_(own.first),
      others_(static_cast<std::uint32_t>(inner.size())),
      dims_(at(dims)),
      inner_(inner.size() + 1, no_bounds(dims)),
      boxes_(inner.size() + 1, no_bounds(dims)) {
  for (std::size_t p = 0; p < inner.size(); ++p)
    for (std::size_t a = 0; a < dims_; ++a) {
      inner_[p].lo[a] = std::nextafter(inner[p].lo[a], Bounds::kInfinity);
      inner_[p].hi[a] = std::nextafter(inner[p].hi[a], -Bounds::kInfinity);
    }
}

std::uint64_t OwnBoxes::not_held(const Axes& x, const BucketsOfBlock& index) {
  const std::uint64_t beyond = kernels().outside_own(x, index.data(), boxes_.data());
  return hold(x, beyond, [&](std::size_t i) { return at(index[i]); });
}

std::uint64_t OwnBoxes::not_held(const Axes& x, std::int32_t index) {
  return hold(x, kernels().outside(x, boxes_[at(index)]), [own = at(index)](std::size_t) { return own; });
}

// Those in their inner region make the box grow; returns the others. Mostly `beyond` are few.
template <typename IndexOf>
std::uint64_t OwnBoxes::hold(const Axes& x, std::uint64_t beyond, const IndexOf& index_of) {
  std::uint64_t out = 0;
  for (; beyond != 0; beyond &= beyond - 1) {
    const auto i = at(std::countr_zero(beyond));
    const Bounds& inner = inner_[index_of(i)];
    bool inside = true;
    for (std::size_t a = 0; a < x.size(); ++a) inside &= (x[a][i] >= inner.lo[a]) & (x[a][i] <= inner.hi[a]);
    out |= std::uint64_t{!inside} << i;
    if (inside) boxes_[index_of(i)].extend(dims_, [&](std::size_t a) { return particles::Range{x[a][i], x[a][i]}; });
  }
  return out;
}

bool OwnBoxes::hold_block(const particles::BlockRanges& ranges, std::size_t block, std::int32_t index) {
  const Bounds& inner = inner_[at(index)];
  for (std::size_t a = 0; a < dims_; ++a) {
    const particles::Range& own = ranges.of[a][block];
    if (!(own.lo >= inner.lo[a] && own.hi <= inner.hi[a])) return false;
  }
  boxes_[at(index)].extend(dims_, [&](std::size_t a) { return ranges.of[a][block]; });
  return true;
}

void OwnBoxes::copy_to(std::span<Bounds> boxes_of_parts) const {
  std::copy_n(boxes_.begin(), others_, boxes_of_parts.begin() + first_);
}

PutHeld::PutHeld(const particles::ParticleView& particles, const CurrentPartition& current, const GuideFromCuts& guide,
                 const AxisMaps& maps, const std::optional<ExactScale>& scale, const Tuning& tuning, PointStore& points)
    : particles_(particles),
      current_(current),
      guide_(guide),
      maps_(maps),
      scale_(scale),
      tuning_(tuning),
      points_(points),
      listed_(particles.count) {}

OwnShare PutHeld::run(std::size_t most) {
  const std::size_t parts = at(current_.tree.parts);
  OwnShare own(Splitters::kBuckets + parts, particles_.dims);
  own.left.resize(parts);
  OwnBoxes boxes(current_.own, guide_.inner, particles_.dims);
  const WalkTables tables(guide_.guide.splitters);
  BucketsOfBlock index{};
  // Those of a block that aren't held.
  const auto not_held = [&](std::size_t first, Blocks& blocks) {
    const std::int32_t* const part = current_.part.data() + first;
    const std::size_t count = std::min(kBlock, particles_.count - first);
    std::int32_t other = 0;
    for (std::size_t i = 0; i < count; ++i) other |= part[i] ^ part[0];
    if (other == 0) {
      const std::int32_t own_index = boxes.index_of(part[0]);
      if (current_.blocks != nullptr && boxes.hold_block(*current_.blocks, first / kBlock, own_index))
        return std::uint64_t{0};
      return boxes.not_held(blocks.read(first), own_index);
    }
    index.fill(boxes.index_of(part[0]));
    for (std::size_t i = 0; i < count; ++i) index[i] = boxes.index_of(part[i]);
    return boxes.not_held(blocks.read(first), index);
  };
  Blocks some(particles_);
  // Where ranges are known, blocks that are held as a whole soon make the boxes grow.
  if (current_.blocks == nullptr) for_seeds(particles_.count, [&](std::size_t first) { (void)not_held(first, some); });
  const auto choose = [&](std::size_t first, Blocks& blocks, BucketsOfBlock&) {
    if (listed_.count() > most) return std::uint64_t{0};
    const std::uint64_t which = not_held(first, blocks) & blocks.present(first);
    if (which != 0) listed_.add(first / kBlock, which);
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
      own.left[at(current_.part[slot])] += load;
    }
  };
  own.lossless = make_points(particles_, maps_, tuning_, points_, choose, place);
  boxes.copy_to(std::span(own.boxes).subspan(Splitters::kBuckets));
  return own;
}

Lossless PutHeld::make(std::span<const std::int32_t> wanted) {
  std::vector<std::uint8_t> is_wanted(at(current_.tree.parts), 0);
  for (const std::int32_t b : wanted) is_wanted[at(b) - Splitters::kBuckets] = 1;
  const auto choose = [&](std::size_t first, Blocks& blocks, BucketsOfBlock& bucket) {
    std::uint64_t which = 0;
    for (std::size_t i = 0; i < std::min(kBlock, particles_.count - first); ++i) {
      const std::int32_t part = current_.part[first + i];
      which |= std::uint64_t{is_wanted[at(part)]} << i;
      bucket[i] = part + static_cast<std::int32_t>(Splitters::kBuckets);
    }
    which &= ~listed_.of_block(first / kBlock);
    if (which == 0) return which;
    blocks.read(first);
    listed_.add(first / kBlock, which);
    return which;
  };
  return make_points(particles_, maps_, tuning_, points_, choose, [](auto&&...) {});
}

void PutHeld::list_moved(std::span<const std::int32_t> moved) {
  for (std::size_t first = 0; first < particles_.count; first += kBlock) {
    std::uint64_t which = 0;
    for (std::size_t i = 0; i < std::min(kBlock, particles_.count - first); ++i) {
      const std::int32_t part = current_.part[first + i];
      which |= std::uint64_t{moved[at(part)] != part} << i;
    }
    listed_.add(first / kBlock, which & ~listed_.of_block(first / kBlock));
  }
}

}  // namespace rcb::partition
