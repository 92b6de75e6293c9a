// The ways of a push to two ranks, of which the first owns the parts 0 and 1, the second 2 and 3: which way is taken,
// and which rows each rank gets.
#include <algorithm>
#include <array>
#include <bit>
#include <numeric>

#include <gtest/gtest.h>

#include "client/lib/client.hpp"
#include "tests/client/lib/two_ranks.hpp"

namespace rcb::client {
namespace {

using protocol::Json;

// Rows in the parts 3 0 2 1 1 2: the first rank owns the rows 1, 3 and 4.
const std::vector<double> kFarX{3.5, 0.5, 2.5, 1.5, 1.25, 2.25}, kFarY{0, 1, 2, 3, 4, 5};
const std::vector<std::int64_t> kFarIds{70, 10, 60, 40, 20, 50};
const std::array<const double*, 2> kFar{kFarX.data(), kFarY.data()};
const std::vector<std::int64_t> kGrouped{1, 3, 4, 0, 2, 5};

// Pushes the rows so many times.
void push_rows(TwoRanks& service, int times, Path path, std::span<const std::int64_t> ids, SeatOptions seat = {}) {
  {
    auto client = Client::connect({.endpoint = service.endpoint(), .token = TwoRanks::kToken, .path = path});
    ASSERT_TRUE(client.ok()) << client.status().message();
    auto scene = client->open_scene("s", seat);
    ASSERT_TRUE(scene.ok()) << scene.status().message();
    for (int k = 0; k < times; ++k) {
      const auto result = scene->step(Positions::axes(kFar, 6), {.ids = ids});
      EXPECT_TRUE(result.ok()) << result.status().message();
    }
  }
  service.stop();
  ASSERT_EQ(service.begun.size(), static_cast<std::size_t>(times));
}

// What came of a step over sockets, the first rank's first.
template <typename T>
std::vector<T> sent(const TwoRanks& service, int step, const char* name) {
  std::vector<T> values;
  for (int rank = 0; rank < 2; ++rank)
    for (const Received& slice : service.slices) {
      if (slice.json["step"] != step || slice.json["rank"] != rank) continue;
      EXPECT_EQ(slice.json["first"], 0);
      const auto part = slice.values<T>(name);
      values.insert(values.end(), part.begin(), part.end());
    }
  return values;
}

template <typename T>
std::vector<T> of_rows(const std::vector<T>& values, const std::vector<std::int64_t>& rows) {
  std::vector<T> picked;
  for (const std::int64_t row : rows) picked.push_back(values[static_cast<std::size_t>(row)]);
  return picked;
}

TEST(Ways, RowsGoStraightToTheRanksThatOwnThem) {
  TwoRanks service;
  push_rows(service, 2, Path::direct, kFarIds);
  const std::vector<std::int64_t> even{0, 1, 2, 3, 4, 5};  // nothing is known of the cuts
  for (const int step : {0, 1}) {
    const Json& begin = service.begun[static_cast<std::size_t>(step)];
    EXPECT_EQ(begin["way"], "sockets");
    EXPECT_EQ(begin["ids"], true);
    EXPECT_EQ(begin["n"], 6);
    EXPECT_EQ(begin["counts"], Json({3, 3}));
    const auto& rows = step == 0 ? even : kGrouped;
    EXPECT_EQ(sent<double>(service, step, "x"), of_rows(kFarX, rows));
    EXPECT_EQ(sent<double>(service, step, "y"), of_rows(kFarY, rows));
    EXPECT_EQ(sent<std::int64_t>(service, step, "id"), of_rows(kFarIds, rows));
  }
  EXPECT_FALSE(service.begun[0].contains("drifted"));
}

// In row order they are numbered by the ranks, in another they bring their numbers.
TEST(Ways, RowsWithoutIdsAreNumbered) {
  TwoRanks service;
  push_rows(service, 2, Path::direct, {});
  EXPECT_EQ(service.begun[0]["ids"], false);
  EXPECT_EQ(sent<double>(service, 0, "x"), kFarX);
  EXPECT_EQ(service.begun[1]["ids"], true);
  EXPECT_EQ(sent<std::int64_t>(service, 1, "id"), kGrouped);
}

TEST(Ways, RowsThatAreIdsAreReadWhereTheyAre) {
  TwoRanks service;
  push_rows(service, 2, Path::automatic, {});
  for (std::size_t step : {0U, 1U}) {
    EXPECT_EQ(service.begun[step]["way"], "shared-memory");
    EXPECT_FALSE(service.begun[step].contains("counts"));
    EXPECT_EQ(service.shared[step].size(), 2U);
    for (std::size_t row = 0; row < 6; ++row)
      EXPECT_EQ(std::bit_cast<double>(service.shared[step]["x"].at(row)), kFarX[row]);
  }
  EXPECT_TRUE(service.slices.empty());
}

TEST(Ways, OfOtherRowsAListTellsWhoReadsWhich) {
  for (const bool seated : {false, true}) {
    TwoRanks service;
    push_rows(service, 2, Path::automatic, kFarIds, {.seat = 0, .seats = seated ? 2 : 1});
    for (std::size_t step : {0U, 1U}) {
      EXPECT_EQ(service.begun[step]["way"], "shared-memory");
      EXPECT_EQ(service.begun[step]["counts"], Json({3, 3}));
      EXPECT_FALSE(service.begun[step].contains("sockets"));
      EXPECT_EQ(service.shared[step]["id"], kFarIds);
    }
    EXPECT_EQ(service.shared[0]["row"], (std::vector<std::int64_t>{0, 1, 2, 3, 4, 5}));
    EXPECT_EQ(service.shared[1]["row"], kGrouped);
  }
}

TEST(Ways, ARankOnAnotherHostGetsItsRowsOverItsSocket) {
  for (const bool with_ids : {true, false}) {
    TwoRanks service(true);
    push_rows(service, 2, Path::shared,
              with_ids ? std::span<const std::int64_t>(kFarIds) : std::span<const std::int64_t>());
    for (const int step : {0, 1}) {
      const Json& begin = service.begun[static_cast<std::size_t>(step)];
      EXPECT_EQ(begin["way"], "shared-memory");
      EXPECT_EQ(begin["sockets"], Json({1}));
      EXPECT_EQ(begin["counts"], Json({3, 3}));
      EXPECT_EQ(begin["ids"], true);  // rows in memory have numbers, those of a socket don't
      const std::vector<std::int64_t> rows{kGrouped.begin() + 3, kGrouped.end()};
      const std::vector<std::int64_t> even{3, 4, 5};
      EXPECT_EQ(sent<double>(service, step, "x"), of_rows(kFarX, step == 0 ? even : rows));
    }
    EXPECT_EQ(service.shared[1]["row"], kGrouped);
    EXPECT_EQ(service.shared[1]["id"], with_ids ? kFarIds : std::vector<std::int64_t>({0, 1, 2, 3, 4, 5}));
  }
}

// Neither is worth the coordination with the ranks.
TEST(Ways, FewRowsGoThroughTheEndpointWhereMemoryIsNotShared) {
  TwoRanks service(true);
  service.scene = {{"step", 3}, {"ids", true}};
  push_rows(service, 1, Path::automatic, kFarIds);
  EXPECT_EQ(service.begun[0]["way"], "endpoint");
}

}  // namespace
}  // namespace rcb::client
