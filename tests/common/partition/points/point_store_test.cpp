// Points that are made, batched and stored by bucket, against plain lists: whatever the blocks, masks and chunks are.
#include "common/partition/points/point_store.hpp"

#include <algorithm>
#include <bit>
#include <map>
#include <numeric>

#include <gtest/gtest.h>

#include "common/base/index.hpp"
#include "common/base/random.hpp"

namespace rcb::partition {
namespace {

constexpr std::size_t kStoredBuckets = 5;
constexpr std::uint64_t kStoredRounds = 200;

struct StoredScene {
  Random random;
  std::size_t blocks;
  std::array<std::vector<double>, geometry::kDimsMax> x;

  explicit StoredScene(std::uint64_t seed) : random(seed), blocks(1 + random.below(12)) {
    for (auto& axis : x) {
      axis.resize(blocks * kBlock);
      for (double& value : axis) value = random.below(8) == 0 ? 0.25 : random.uniform(-2, 2);
    }
  }
  Axes block(std::size_t k) const { return {&x[0][k * kBlock], &x[1][k * kBlock], &x[2][k * kBlock]}; }
  std::uint64_t mask() {
    const std::uint64_t any = random.next();
    return std::array{any, any & random.next() & random.next(), ~std::uint64_t{0}, std::uint64_t{0}}[random.below(4)];
  }
  std::array<std::int32_t, kBlock> buckets() {
    std::array<std::int32_t, kBlock> own;
    const std::uint64_t runs = 1 + random.below(20);  // neighbours often share a bucket
    for (std::size_t i = 0; i < kBlock; ++i)
      own[i] = i == 0 || random.below(runs) == 0 ? static_cast<std::int32_t>(random.below(kStoredBuckets)) : own[i - 1];
    return own;
  }
};

TEST(PointStore, HasEachPointInItsBucketAndChunk) {
  for (std::uint64_t seed = 0; seed < kStoredRounds && !::testing::Test::HasFailure(); ++seed) {
    SCOPED_TRACE(seed);
    StoredScene scene(seed);
    const bool linear = seed % 3 != 0;
    AxisMaps maps;
    for (AxisMap& map : maps) map = linear ? AxisMap::by_value(-1, 1) : AxisMap::by_order_bits(-1, 1);
    PointStore store(kStoredBuckets, 1 + scene.random.below(100));
    PointMaker maker(maps, geometry::kDimsMax, linear && seed % 2 == 0, store);
    std::array<std::map<std::uint64_t, Integers>, kStoredBuckets> expected;  // by particle
    const std::size_t chunk = 1 + scene.random.below(5);                     // blocks
    std::uint64_t base = 0;
    const auto expect_all_of = [&](std::size_t bucket) {
      std::map<std::uint64_t, Integers> got;
      for (const Segment& segment : store.take(bucket)) {
        EXPECT_GT(segment.size(), 0U);
        for (const QuantisedPoint& point : segment.all())
          EXPECT_TRUE(got.emplace(segment.base + point.index, point.q).second) << "twice";
      }
      EXPECT_EQ(got, expected[bucket]) << "bucket " << bucket;
      EXPECT_EQ(store.count(bucket), 0U);
      expected[bucket].clear();
    };
    for (std::size_t k = 0; k < scene.blocks; ++k) {
      if (k % chunk == 0) store.begin_chunk(base = k * kBlock);
      const std::array<std::int32_t, kBlock> bucket = scene.buckets();
      const std::uint64_t which = scene.mask();
      std::array<std::uint32_t, kBlock> index;
      std::iota(index.begin(), index.end(), static_cast<std::uint32_t>(k * kBlock - base));
      if (which != 0) maker.make(scene.block(k), index.data(), bucket.data(), which);
      for (std::size_t i = 0; i < kBlock; ++i) {
        if ((which >> i & 1U) == 0) continue;
        Integers q;
        for (std::size_t a = 0; a < q.size(); ++a) q[a] = maps[a](scene.x[a][k * kBlock + i]);
        expected[at(bucket[i])][k * kBlock + i] = q;
      }
      for (std::size_t b = 0; b < kStoredBuckets; ++b) ASSERT_EQ(store.count(b), expected[b].size());
      if (scene.random.below(6) == 0) expect_all_of(scene.random.below(kStoredBuckets));  // it is filled again later
    }
    for (std::size_t b = 0; b < kStoredBuckets; ++b) expect_all_of(b);
  }
}

TEST(PointStore, BatchesKeepTheChosenOnesInOrder) {
  for (std::uint64_t seed = 0; seed < kStoredRounds && !::testing::Test::HasFailure(); ++seed) {
    SCOPED_TRACE(seed);
    StoredScene scene(seed);
    struct Chosen {
      std::uint32_t index;
      std::int32_t bucket;
    };
    std::vector<Chosen> expected;
    std::size_t next = 0;
    Batch batch;
    const auto take_block = [&] {
      const Axes x = batch.block();
      const auto count = at(std::popcount(batch.present()));
      ASSERT_EQ(count, std::min(kBlock, expected.size() - next));
      for (std::size_t k = 0; k < kBlock; ++k) {
        const Chosen& own = expected[next + (k < count ? k : 0)];  // filled up with copies
        for (std::size_t a = 0; a < x.size(); ++a) ASSERT_EQ(x[a][k], scene.x[a][own.index]);
        if (k >= count) continue;
        ASSERT_EQ(batch.index[k], own.index);
        ASSERT_EQ(batch.bucket[k], own.bucket);
      }
      next += count;
      batch.drop();
    };
    for (std::size_t k = 0; k < scene.blocks; ++k) {
      const std::array<std::int32_t, kBlock> bucket = scene.buckets();
      const std::uint64_t which = scene.mask();
      const auto first = static_cast<std::uint32_t>(k * kBlock);
      for (std::uint32_t i = 0; i < kBlock; ++i)
        if ((which >> i & 1U) != 0) expected.push_back({first + i, bucket[i]});
      if (which != 0) batch.add(first, scene.block(k), which, bucket.data());
      if (batch.size >= kBlock) take_block();
    }
    if (batch.size > 0) take_block();
    EXPECT_EQ(next, expected.size());
    EXPECT_EQ(batch.size, 0U);
  }
}

}  // namespace
}  // namespace rcb::partition
