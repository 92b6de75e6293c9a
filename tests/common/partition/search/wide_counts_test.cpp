// Counts far beyond 2^32, without the particles: a Comm that answers for crowds of ranks that hold the same.
#include <cmath>

#include <boost/multiprecision/cpp_int.hpp>
#include <gtest/gtest.h>

#include "common/comm/wide_sum.hpp"
#include "common/partition/balance/load.hpp"
#include "common/partition/partition.hpp"
#include "tests/support/forwarding_comm.hpp"
#include "tests/support/self_comm.hpp"

namespace rcb::partition {
namespace {

using Number = boost::multiprecision::cpp_rational;

// SelfComm, but every sum is what `sum` makes of the local value.
struct OwnComm {
  testing::SelfComm self;
};
class FakeComm final : OwnComm, public testing::ForwardingComm {
 public:
  using Sum = std::uint64_t (*)(std::uint64_t local);
  explicit FakeComm(Sum sum) : ForwardingComm(self), sum_(sum) {}
  void all_sum(std::span<std::uint64_t> values) override {
    for (std::uint64_t& value : values) value = sum_(value);
  }

 private:
  Sum sum_;
};

// Particles stand in groups along x: kHeavy at one place, then kLight apart from each other, and so on. A sum counts
// each heavy one kCopies times and each light one once; there are fewer light ones than kHeavy, so that it can tell.
// Cuts fall among light particles alone.
constexpr std::uint64_t kHeavy = 1024;
constexpr std::uint64_t kLight = 100;
constexpr std::uint64_t kCopies = std::uint64_t{1} << 50U;

std::uint64_t crowd(std::uint64_t local) { return local / kHeavy * kHeavy * kCopies + local % kHeavy; }

particles::ParticleSet make_groups(int parts) {
  particles::ParticleSet set;
  set.dims = 1;
  const auto groups = static_cast<std::size_t>(parts);
  set.resize(groups * kHeavy + (groups - 1) * kLight);
  for (std::size_t i = 0; i < set.id.size(); ++i) {
    const std::size_t in_group = i % (kHeavy + kLight);
    const double place = in_group < kHeavy ? 0 : static_cast<double>(1 + in_group - kHeavy);
    set.position[0][i] = static_cast<double>(i / (kHeavy + kLight)) * 1000 + place;
    set.id[i] = static_cast<Id>(i);
  }
  return set;
}

TEST(WideCounts, CutsFallWhereTheQuotasSay) {
  for (const int parts : {2, 3, 7}) {
    const particles::ParticleSet set = make_groups(parts);
    FakeComm comm(crowd);
    PartitionOptions options;
    options.parts = parts;
    const PartitionResult got = partition(comm, set.view(), options).value();
    const auto groups = static_cast<std::uint64_t>(parts);
    const u128 n = u128{groups} * kHeavy * kCopies + (groups - 1) * kLight;
    EXPECT_GT(n, u128{1} << 60U);
    for (std::size_t i = 0; i < set.id.size(); ++i) {
      const std::uint64_t group = i / (kHeavy + kLight);
      const std::uint64_t in_group = i % (kHeavy + kLight);
      std::uint64_t part = group;
      if (in_group >= kHeavy) {
        const u128 before = u128{group + 1} * kHeavy * kCopies + u128{group} * kLight + (in_group - kHeavy);
        part += before < u128{group + 1} * n / groups ? 0U : 1U;
      }
      ASSERT_EQ(got.part[i], static_cast<std::int32_t>(part)) << "particle " << i << ", parts " << parts;
    }
  }
}

// No double is nearer to `value`.
void expect_rounded(double got, const Number& value) {
  const Number off = abs(Number(got) - value);
  EXPECT_LE(off, abs(Number(std::nextafter(got, HUGE_VAL)) - value)) << got;
  EXPECT_LE(off, abs(Number(std::nextafter(got, -HUGE_VAL)) - value)) << got;
}

TEST(WideCounts, LoadsAreSummedInSixtyFourBits) {
  constexpr int kParts = 3;
  const particles::ParticleSet set = make_groups(kParts);
  std::vector<std::int32_t> part;
  std::array<std::uint64_t, kParts> counts{};
  for (std::size_t i = 0; i < set.id.size(); ++i) {
    part.push_back(static_cast<std::int32_t>(i / (kHeavy + kLight)));
    counts[i / (kHeavy + kLight)] += i % (kHeavy + kLight) < kHeavy ? kCopies : 1;
  }
  FakeComm comm(crowd);
  const std::vector<double> sizes{1, 2.5, 0.3};
  const LoadSummary got = summarise_loads(comm, set.view(), part, sizes, kParts);
  Number total = 0;
  for (const std::uint64_t count : counts) total += count;
  Number worst = 0;
  for (std::size_t p = 0; p < kParts; ++p) {
    EXPECT_EQ(got.counts[p], counts[p]);
    const Number target = total * Number(sizes[p]) / (Number(sizes[0]) + Number(sizes[1]) + Number(sizes[2]));
    expect_rounded(got.targets[p], target);
    worst = std::max(worst, Number(abs(Number(counts[p]) - target) / target));
  }
  expect_rounded(got.error, worst);
}

// One particle too many of 3 * 2^60 still shows.
TEST(WideCounts, ErrorSeesOneParticle) {
  constexpr std::uint64_t kEach = std::uint64_t{1} << 60U;
  EXPECT_EQ(summarise_counts({kEach, kEach, kEach}, {}).error, 0);
  const LoadSummary got = summarise_counts({kEach + 1, kEach, kEach - 1}, {});
  EXPECT_EQ(got.error, 0x1p-60);
}

constexpr std::uint64_t kRanks = std::uint64_t{1} << 21U;

TEST(WideCounts, WideSumsOfTwoMillionRanksLoseNoCarry) {
  FakeComm comm([](std::uint64_t local) { return local * kRanks; });
  constexpr u128 kMost = ~u128{0} >> 21U;
  std::vector<u128> values{kMost, kMost - 1, (u128{1} << 86U) - 1, (u128{1} << 43U) - 1, 1, 0};
  const std::vector<u128> local = values;
  comm::all_sum_wide(comm, values);
  for (std::size_t i = 0; i < local.size(); ++i) EXPECT_TRUE(values[i] == local[i] * kRanks) << i;
}

}  // namespace
}  // namespace rcb::partition
