// Counts: that their loads are those of the positions, and what is refused of them.
#include "server/scene/count.hpp"

#include <functional>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "tests/server/scene/counting.hpp"
#include "tests/support/scenes.hpp"
#include "tests/support/self_comm.hpp"

namespace rcb::testing {
namespace {

using scene::CountRecord;
using scene::loads_of;

TEST(Count, OfNothingIsEmpty) {
  CountRecord record;
  record.weights.emplace();
  const auto loads = loads_of(record, 2, {});
  ASSERT_TRUE(loads.ok());
  EXPECT_EQ(loads->counts, (std::vector<std::uint64_t>{0, 0}));
  EXPECT_FALSE(loads->weighted);
}

TEST(Count, HasNoMoreLoadThanWeightsCanHave) {
  const auto loads = [](u128 first, u128 second) {
    CountRecord record;
    record.n = 7;
    record.parts = {0, 3};
    record.counts = {5, 2};
    record.weights = scene::WeightCount{ExactScale(5, 7).exponent(), 1, 5, 0, {first, second}};
    return loads_of(record, 4, {}).status().code();
  };
  constexpr u128 kHalf = u128{1} << 126U;
  EXPECT_EQ(loads(kHalf, kHalf - 1), Code::ok);
  EXPECT_EQ(loads(kHalf, kHalf), Code::invalid_argument);
  EXPECT_EQ(loads(~u128{0}, kHalf), Code::invalid_argument);
}

// The count of particles in random parts, of which each seat has a share; in the scale of the summary where that is
// due.
Result<CountRecord> counted(Random& random, const particles::ParticleView& particles,
                            std::span<const std::int32_t> part, std::size_t seats,
                            const std::function<void(std::size_t, CountRecord&)>& change = {}) {
  scene::Tally tally(seats);
  const int scale = scale_needed(particles).value_or(0);
  for (std::size_t seat = 0, first = 0; seat < seats; ++seat) {
    EXPECT_FALSE(tally.whole());
    const std::size_t last = seat + 1 == seats ? particles.count : first + random.below(particles.count - first + 1);
    CountRecord record = count_rows(particles, part, std::exchange(first, last), last, scale);
    record.step = 1;
    record.epoch = 1;
    if (change) change(seat, record);
    tally.put(seat, *received(record));
  }
  EXPECT_TRUE(tally.whole());
  return tally.sum(4);
}

TEST(Count, GivesTheLoadsOfThePositionsHoweverManySeatsCount) {
  SelfComm comm;
  for (std::uint64_t seed = 1; seed <= 800; ++seed) {
    SCOPED_TRACE(fmt::format("seed {}", seed));
    Random random(seed);
    const Scene scene = make_scene(Shape::uniform, static_cast<Weights>(seed % kWeights), 1, random.below(200),
                                   random.below(2) == 0, seed);
    const Share share = deal(scene, 0, 1, seed);
    const auto view = share.particles.view();
    const int parts = 1 + static_cast<int>(random.below(9));
    std::vector<double> sizes;
    for (int p = 0; p < parts && seed % 3 == 0; ++p) sizes.push_back(random.uniform(0.1, 4));
    std::vector<std::int32_t> part(view.count);
    for (std::int32_t& p : part) p = static_cast<std::int32_t>(random.below(static_cast<std::uint64_t>(parts)));
    const auto record = counted(random, view, part, 1 + random.below(5));
    ASSERT_TRUE(record.ok()) << record.status().message();
    const auto loads = loads_of(*record, parts, sizes);
    ASSERT_TRUE(loads.ok()) << loads.status().message();
    const auto expected = partition::summarise_loads(comm, view, part, sizes, parts);
    EXPECT_EQ(loads->counts, expected.counts);
    EXPECT_EQ(loads->loads, expected.loads);
    EXPECT_EQ(loads->weighted, expected.weighted);
    EXPECT_EQ(loads->scale_exponent, expected.scale_exponent);
    EXPECT_EQ(loads->weights_as_zero, expected.weights_as_zero);
    EXPECT_EQ(loads->error, expected.error);
    EXPECT_EQ(loads->imbalance, expected.imbalance);
    EXPECT_EQ(loads->part_errors, expected.part_errors);
    EXPECT_EQ(loads->targets, expected.targets);
    EXPECT_EQ(loads->load_values, expected.load_values);
    std::uint64_t id_sum = 0;
    for (std::size_t i = 0; i < view.count; ++i) id_sum += mix64(static_cast<std::uint64_t>(view.id[i]));
    EXPECT_EQ(record->id_sum, id_sum);
    EXPECT_EQ(record->n, view.count);
  }
}

TEST(Count, StrangersAreInPartsOfOtherSeats) {
  const auto strangers = [](int parts, const std::vector<std::vector<std::uint64_t>>& by_seat) {
    scene::Tally tally(by_seat.size());
    for (std::size_t seat = 0; seat < by_seat.size(); ++seat) {
      CountRecord record;
      record.id_sum = 0;
      for (std::size_t p = 0; p < by_seat[seat].size(); ++p) {
        record.parts.push_back(static_cast<std::int32_t>(p));
        record.counts.push_back(by_seat[seat][p]);
        record.n += by_seat[seat][p];
      }
      tally.put(seat, record);
    }
    return tally.sum(parts)->strangers;
  };
  EXPECT_EQ(strangers(5, {{1, 2, 4, 8, 16}}), 0U);
  EXPECT_EQ(strangers(5, {{1, 2, 4, 8, 16}, {32, 64, 128, 256, 512}}), 4U + 8 + 16 + 32 + 64);  // parts 0 1, 2 3 4
  EXPECT_EQ(strangers(5, {{1, 2}, {4, 8}, {0, 0, 0, 16}}), 2U + 4);                             // 0, 1 2, 3 4
  EXPECT_EQ(strangers(1, {{1}, {2}, {4}}), 3U);                                                 // none, none, 0
}

TEST(Count, OfSeatsThatDisagreeIsOfNoUse) {
  Random random(7);
  const Share share = deal(make_scene(Shape::uniform, Weights::wide, 2, 400, false, 7), 0, 1, 7);
  const auto view = share.particles.view();
  const std::vector<std::int32_t> part(view.count, 2);
  const auto sum = [&](const std::function<void(CountRecord&)>& change_last) {
    return counted(random, view, part, 3, [&](std::size_t seat, CountRecord& record) {
      if (seat == 2) change_last(record);
    });
  };
  EXPECT_EQ(sum([](CountRecord&) {})->epoch, 1U);
  EXPECT_EQ(sum([](CountRecord& record) { record.hash = 2; })->epoch, 0U);
  EXPECT_EQ(sum([](CountRecord& record) { record.epoch = 2; })->epoch, 0U);
  const auto scales = sum([](CountRecord& record) { record.weights->scale = -3; });
  EXPECT_NE(scales->weights->scale, scene::scale_due(*scales->weights, scales->n));
  EXPECT_EQ(sum([](CountRecord& record) { record.id_sum.reset(); }).status().code(), Code::invalid_argument);
  EXPECT_EQ(sum([](CountRecord& record) { record.weights.reset(); }).status().message(),
            "the count of seat 2: it has no weights");
}

}  // namespace
}  // namespace rcb::testing
