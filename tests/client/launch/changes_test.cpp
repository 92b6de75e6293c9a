// The library against a real service: particles come, go and change their order, another client's steps in between.
// What it tells of rows and parts is what the service holds, by every path.

#include <gtest/gtest.h>

#include "client/launch/launch.hpp"
#include "client/lib/client.hpp"
#include "common/base/random.hpp"
#include "tests/client/launch/rows.hpp"

namespace rcb::client {
namespace {

void walk(const std::string& endpoint, std::uint64_t seed) {
  SCOPED_TRACE(::testing::Message() << "seed " << seed);
  Random random(seed);
  ConnectOptions where;
  where.endpoint = endpoint;
  where.path = std::array{Path::gateway, Path::direct, Path::shared}[seed % 3];
  auto client = Client::connect(where);
  auto other = Client::connect(where);
  ASSERT_TRUE(client.ok() && other.ok());
  const char* positions = seed < 4 ? "every-step" : "when-needed";
  ASSERT_TRUE(
      client
          ->create_scene("walk",
                         {.parts = 6, .tolerance = seed % 2 == 0 ? 1e9 : 0.1, .positions = positions, .replace = true})
          .ok());
  auto scene = client->open_scene("walk");
  ASSERT_TRUE(scene.ok());
  Rows rows;
  rows.add(400, random, seed % 4 == 0);
  bool ids = false;  // else the rows' numbers are
  for (std::int64_t step = 0; step < 30; ++step) {
    SCOPED_TRACE(::testing::Message() << "step " << step);
    StepOptions options;
    if (step > 0 && random.below(6) == 0) {  // another client steps in between
      auto theirs = other->open_scene("walk");
      ASSERT_TRUE(theirs.ok());
      if (ids) options.ids = rows.ids;
      options.weights = rows.weights;
      const auto done = theirs->step(rows.positions(), options);
      ASSERT_TRUE(done.ok()) << done.status().message();
      options.step = theirs->last_step().value() + 1;
    }
    options.want_changes = true;
    options.want_parts = random.below(2) == 0;
    rows.move(random, 0.05);
    ids = ids || random.below(5) == 0;
    if (ids && step > 0 && random.below(2) == 0) rows.change(random, 30, options);
    if (ids) options.ids = rows.ids;
    options.weights = rows.weights;
    const auto result = scene->step(rows.positions(), options);
    ASSERT_TRUE(result.ok()) << result.status().message();
    rows.note(*result);
    if (options.want_parts) {
      ASSERT_EQ(result->parts, rows.parts);
    }
    if (result->report.sent) {
      EXPECT_TRUE(rows.expect_held(*client, "walk"));
    }
    if (::testing::Test::HasFailure()) return;
  }
}

TEST(Changes, TheLibraryKnowsWhatTheServiceHolds) {
  auto service = launch::Embedded::start(3, [](double) {});
  ASSERT_TRUE(service.ok()) << service.status().message();
  for (std::uint64_t seed = 1; seed <= 9 && !HasFailure(); ++seed) walk(service->endpoint(), seed);
}

// A step with other particles than it says is refused, and the one before stands.
TEST(Changes, NothingIsLostOrDoubledUnsaid) {
  auto service = launch::Embedded::start(2, [](double) {});
  ASSERT_TRUE(service.ok());
  for (const char* positions : {"every-step", "when-needed"}) {
    auto client = Client::connect({.endpoint = service->endpoint()});
    ASSERT_TRUE(client->create_scene(positions, {.parts = 3, .positions = positions}).ok());
    auto scene = client->open_scene(positions);
    Random random(5);
    Rows rows;
    rows.add(100, random, false);
    ASSERT_TRUE(scene->step(rows.positions(), {.ids = rows.ids}).ok());
    const auto code = [&](std::uint64_t inserted, std::uint64_t removed) {
      return scene->step(rows.positions(), {.ids = rows.ids, .inserted = inserted, .removed = removed}).status().code();
    };
    rows.ids[7] = 1000;  // the count is right
    EXPECT_EQ(code(0, 0), Code::not_conserved);
    rows.ids[7] = 6;
    EXPECT_EQ(code(1, 1), Code::duplicate_id);
    rows.ids[7] = 7;
    rows.add(3, random, false);
    EXPECT_EQ(code(0, 0), Code::not_conserved);
    EXPECT_EQ(code(4, 0), Code::not_conserved);
    EXPECT_EQ(scene->last_step(), 0);
    EXPECT_EQ(code(5, 2), Code::ok);
    EXPECT_EQ(scene->last_step(), 1);
  }
}

}  // namespace
}  // namespace rcb::client
