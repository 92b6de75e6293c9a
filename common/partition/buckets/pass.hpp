// A pass over all particles, which makes the quantised points of those that are chosen.
#pragma once

#include <algorithm>
#include <bit>
#include <numeric>

#include "common/partition/buckets/buckets.hpp"

namespace rcb::partition {

using BucketsOfBlock = std::array<std::int32_t, kBlock>;

// Calls seed(first) with the first particles of some blocks from everywhere, before boxes grow in a pass. Otherwise
// sorted arrays would be slow: each particle would lie outside of the box of those before it.
template <typename Seed>
void for_seeds(std::size_t count, const Seed& seed) {
  constexpr std::size_t kSeeds = 64;
  const std::size_t blocks = particles::blocks_of(count);
  for (std::size_t k = 0; k < blocks; k += std::max<std::size_t>(blocks / kSeeds, 1)) seed(k * kBlock);
}

// Returns what it learns of the maps. Local.
//   choose(first, blocks, bucket)   returns which particles of the block from `first` on are chosen, one bit each; if
//                                   any is, it has called blocks.read(first). Sets their buckets or leaves it to
//                                   `place`
//   place(x, index, bucket, which)  sets the buckets of chosen particles, which may be of several blocks, if `choose`
//                                   hasn't
template <typename Choose, typename Place>
Lossless make_points(const particles::ParticleView& particles, const AxisMaps& maps, const Tuning& tuning,
                     PointStore& points, const Choose& choose, const Place& place) {
  PointMaker maker(maps, particles.dims, may_be_lossless(maps, particles.dims), points);
  Blocks blocks(particles);
  Batch batch;
  BucketsOfBlock bucket{};
  std::array<std::uint32_t, kBlock> index;
  const auto make = [&](const Axes& x, const std::uint32_t* own_index, std::int32_t* own_bucket, std::uint64_t which) {
    place(x, own_index, own_bucket, which);
    maker.make(x, own_index, own_bucket, which);
  };
  const auto make_batch = [&] {
    make(batch.block(), batch.index.data(), batch.bucket.data(), batch.present());
    batch.drop();
  };
  const std::size_t chunk = (tuning.chunk_max + kBlock - 1) / kBlock * kBlock;
  for (std::size_t base = 0; base < particles.count; base += chunk) {
    points.begin_chunk(base);
    for (std::size_t first = base; first < std::min(base + chunk, particles.count); first += kBlock) {
      const std::uint64_t which = choose(first, blocks, bucket) & blocks.present(first);
      const auto first_index = static_cast<std::uint32_t>(first - base);
      if (std::popcount(which) >= Tuning::kMadeAsBlock) {
        std::iota(index.begin(), index.end(), first_index);
        make(blocks.last_read(), index.data(), bucket.data(), which);
      } else if (which != 0) {
        batch.add(first_index, blocks.last_read(), which, bucket.data());
        if (batch.size >= kBlock) make_batch();
      }
    }
    if (batch.size > 0) make_batch();
  }
  return maker.lossless();
}

}  // namespace rcb::partition
