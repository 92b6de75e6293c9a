#include "common/partition/buckets/put.hpp"

#include "common/partition/buckets/pass.hpp"

namespace rcb::partition {

OwnShare put_all(const particles::ParticleView& particles, const Guide& guide, const AxisMaps& maps,
                 const Tuning& tuning, PointStore& points) {
  OwnShare own(Splitters::kBuckets, particles.dims);
  const WalkTables tables(guide.splitters);
  const auto put = [&](const Axes& x, BucketsOfBlock& bucket) {
    if (!guide.split) return;
    kernels().walk(tables, x, bucket.data());
    own.grow(x, bucket.data(), kernels().outside_own(x, bucket.data(), own.boxes.data()));
  };
  BucketsOfBlock seeds{};
  Blocks some(particles);
  for_seeds(particles.count, [&](std::size_t first) { put(some.read(first), seeds); });
  const auto choose = [&](std::size_t first, Blocks& blocks, BucketsOfBlock& bucket) {
    put(blocks.read(first), bucket);
    return ~std::uint64_t{0};
  };
  own.lossless = make_points(particles, maps, tuning, points, choose, [](auto&&...) {});
  for (std::size_t b = 0; b < own.loads.size(); ++b) own.loads[b].count = points.count(b);
  return own;
}

}  // namespace rcb::partition
