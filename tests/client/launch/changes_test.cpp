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
    rows.ids[7] = 7;
    rows.add(3, random, false);
    EXPECT_EQ(code(0, 0), Code::not_conserved);
    EXPECT_EQ(code(4, 0), Code::not_conserved);
    EXPECT_EQ(scene->last_step(), 0);
    EXPECT_EQ(code(5, 2), Code::ok);
    EXPECT_EQ(scene->last_step(), 1);
  }
}

// Twins that come are found as soon as positions travel: at once, or in the next block after the count that brought
// them. That is refused, the step before stands, and the block goes through once it is right.
TEST(Changes, TwinsThatComeAreFoundInABlock) {
  auto service = launch::Embedded::start(3, [](double) {});
  ASSERT_TRUE(service.ok());
  const auto walk = [&](const char* positions, Path path, bool flows_on) {
    SCOPED_TRACE(::testing::Message() << positions << " " << static_cast<int>(path) << " " << flows_on);
    auto client = Client::connect({.endpoint = service->endpoint(), .path = path});
    ASSERT_TRUE(
        client->create_scene("twins", {.parts = 4, .tolerance = 0.5, .positions = positions, .replace = true}).ok());
    auto scene = client->open_scene("twins");
    Random random(5);
    Rows rows;
    rows.add(100, random, false);
    for (std::int64_t& id : rows.ids) id = 10 * id + 1;
    const auto step = [&](std::uint64_t inserted, std::uint64_t removed) {
      return scene->step(rows.positions(),
                         {.ids = rows.ids, .inserted = inserted, .removed = removed, .want_changes = true});
    };
    ASSERT_TRUE(step(0, 0).ok());
    rows.add(2, random, false);
    rows.ids.back() = 61;
    const auto came = step(2, 0);
    const bool counted = came.ok();
    EXPECT_EQ(came.status().code(), counted ? Code::ok : Code::duplicate_id);
    EXPECT_EQ(counted, positions == std::string("when-needed"));
    EXPECT_FALSE(counted && came->report.sent);
    EXPECT_EQ(counted ? came->report.n : 102, 102U);
    EXPECT_EQ(counted ? came->report.inserted : 2, 2U);
    for (double& x : rows.xyz) x *= counted ? 0.3 : 1;  // then new cuts are due
    for (std::size_t k = 0; k < 2; ++k) {
      const auto refused = step(counted ? (flows_on ? 1 : 0) : 2, counted && flows_on ? 1 : 0);
      EXPECT_EQ(refused.status().code(), Code::duplicate_id) << refused.status().message();
      EXPECT_NE(refused.status().message().find("id 61 "), std::string::npos) << refused.status().message();
      EXPECT_EQ(scene->last_step(), counted ? 1 : 0);
    }
    if (counted) {
      const std::int64_t id = std::exchange(rows.ids[3], 62);
      EXPECT_EQ(step(0, 0).status().code(), Code::not_conserved) << "other ids than were counted";
      rows.ids[3] = id;
    }
    rows.ids.back() = 5000;
    const auto mended = step(counted ? 1 : 2, counted ? 1 : 0);
    ASSERT_TRUE(mended.ok()) << mended.status().message();
    EXPECT_TRUE(mended->report.sent);
    EXPECT_EQ(mended->report.repartitioned, counted);
    rows.note(*mended);
    EXPECT_TRUE(rows.expect_held(*client, "twins"));
    rows.ids.back() = 61;  // the ranks know their particles again
    EXPECT_EQ(step(0, 0).status().code(), Code::not_conserved);
  };
  for (const Path path : {Path::gateway, Path::direct, Path::shared})
    for (const bool flows_on : {false, true}) {
      walk("every-step", path, flows_on);
      walk("when-needed", path, flows_on);
    }
}

// A solver whose ids are its rows need not give them after they have told what came, though the ranks don't hold it.
TEST(Changes, RowsThatAreIdsAgainArePushedWithoutThem) {
  auto service = launch::Embedded::start(3, [](double) {});
  ASSERT_TRUE(service.ok());
  for (const Path path : {Path::gateway, Path::direct, Path::shared}) {
    auto client = Client::connect({.endpoint = service->endpoint(), .path = path});
    ASSERT_TRUE(
        client->create_scene("rows", {.parts = 4, .tolerance = 0.5, .positions = "when-needed", .replace = true}).ok());
    auto scene = client->open_scene("rows");
    Random random(6);
    Rows rows;
    rows.add(100, random, true);
    ASSERT_TRUE(scene->step(rows.positions(), {.weights = rows.weights}).ok());
    rows.add(20, random, true);
    const auto grown = scene->step(rows.positions(), {.ids = rows.ids, .weights = rows.weights, .inserted = 20});
    ASSERT_TRUE(grown.ok()) << grown.status().message();
    EXPECT_FALSE(grown->report.sent);
    const auto counted = scene->step(rows.positions(), {.weights = rows.weights});
    EXPECT_FALSE(counted.ok() && counted->report.sent);
    for (double& x : rows.xyz) x *= 0.3;  // new cuts are due
    const auto sent = scene->step(rows.positions(), {.weights = rows.weights, .want_changes = true});
    ASSERT_TRUE(sent.ok()) << sent.status().message();
    EXPECT_TRUE(sent->report.sent);
    rows.note(*sent);
    EXPECT_TRUE(rows.expect_held(*client, "rows"));
  }
}

}  // namespace
}  // namespace rcb::client
