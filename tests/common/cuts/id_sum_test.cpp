#include "common/cuts/id_sum.hpp"

#include <numeric>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "common/base/random.hpp"

namespace rcb::cuts {
namespace {

std::vector<particles::Id> some_ids(Random& random, std::size_t n) {
  std::vector<particles::Id> ids(n);
  for (particles::Id& id : ids) id = static_cast<particles::Id>(random.next() >> (1 + random.below(63)));
  return ids;
}

// As vectors of any length end.
TEST(IdSums, AreWhatTheDefinitionSays) {
  constexpr std::uint64_t kSeed = 5200;
  for (std::size_t n = 0; n < 200; ++n) {
    SCOPED_TRACE(fmt::format("seed {}", kSeed + n));
    Random random(kSeed + n);
    std::vector<particles::Id> ids = some_ids(random, n);
    const std::uint64_t key = n % 3 == 0 ? 0 : random.next();
    IdSums expected;
    for (std::size_t i = 0; i < n; ++i) {
      const std::uint64_t mixed = mix64(static_cast<std::uint64_t>(ids[i]) + key);
      expected.any_order += mixed;
      for (std::size_t place = 0; place <= i; ++place) expected.in_order += mixed;
    }
    EXPECT_EQ(sum_ids(ids, key), expected);
    if (n == 0) continue;
    ids[random.below(n)] = -1 - static_cast<particles::Id>(random.below(9));
    EXPECT_TRUE(sum_ids(ids, key).negative);
  }
}

TEST(IdSums, TellAnOrderFromAnother) {
  Random random(5300);
  std::vector<particles::Id> ids(1000);
  std::iota(ids.begin(), ids.end(), 0);
  const IdSums before = sum_ids(ids, 0);
  for (int k = 0; k < 200; ++k) {
    const std::size_t i = random.below(ids.size()), j = random.below(ids.size());
    std::swap(ids[i], ids[j]);
    const IdSums now = sum_ids(ids, 0);
    EXPECT_EQ(now.any_order, before.any_order);
    EXPECT_EQ(now.in_order == before.in_order, i == j) << i << " and " << j << ", seed 5300";
    std::swap(ids[i], ids[j]);
  }
}

}  // namespace
}  // namespace rcb::cuts
