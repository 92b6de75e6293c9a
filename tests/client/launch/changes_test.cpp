// The library against a real service: few moved, inserted, removed, another client's steps in between. What it tells of
// rows, parts and ids is what the service holds, by both paths.
#include <map>

#include <gtest/gtest.h>

#include "client/launch/launch.hpp"
#include "client/lib/client.hpp"
#include "common/base/random.hpp"
#include "tests/client/launch/rows.hpp"

namespace rcb::client {
namespace {

struct HeldRows : Rows {
  void expect_held(Client& client) const {
    const auto reply = client.call("fetch", "{\"scene\":\"walk\"}");
    ASSERT_TRUE(reply.ok()) << reply.status().message();
    const auto id = reply->find("id")->i8();
    const auto x = reply->find("x")->f8();
    const auto part = reply->find("part")->i4();
    ASSERT_EQ(id.size(), ids.size());
    std::map<std::int64_t, std::pair<double, std::int32_t>> held;
    for (std::size_t i = 0; i < id.size(); ++i) held[id[i]] = {x[i], part[i]};
    for (std::size_t row = 0; row < ids.size(); ++row)
      ASSERT_EQ(held[ids[row]], std::pair(xyz[3 * row], parts[row])) << "row " << row;
  }
};

void walk(const std::string& endpoint, std::uint64_t seed) {
  SCOPED_TRACE(::testing::Message() << "seed " << seed);
  Random random(seed);
  ConnectOptions where;
  where.endpoint = endpoint;
  where.path = std::array{Path::gateway, Path::direct, Path::shared}[seed % 3];
  auto client = Client::connect(where);
  auto other = Client::connect(where);
  ASSERT_TRUE(client.ok() && other.ok());
  ASSERT_TRUE(client->create_scene("walk", {.parts = 6, .tolerance = seed % 2 == 0 ? 1e9 : 0.1, .replace = true}).ok());
  auto scene = client->open_scene("walk");
  ASSERT_TRUE(scene.ok());
  HeldRows rows;
  for (int i = 0; i < 400; ++i) rows.ids.push_back(i);
  for (int k = 0; k < 1200; ++k) rows.xyz.push_back(random.uniform());
  StepOptions first;
  first.want_parts = true;
  auto begun = scene->step(rows.positions(), first);
  ASSERT_TRUE(begun.ok()) << begun.status().message();
  rows.parts = begun->parts;
  for (std::int64_t step = 1; step < 30; ++step) {
    SCOPED_TRACE(::testing::Message() << "step " << step);
    StepOptions options;
    options.want_changes = true;
    options.want_parts = random.below(2) == 0;
    std::vector<std::uint64_t> moved;
    const auto kind = random.below(4);  // all, none, few
    for (std::uint64_t row = 0; row < rows.ids.size(); ++row) {
      if (kind == 1 || (kind > 1 && random.below(9) != 0)) continue;
      moved.push_back(row);
      for (std::size_t a = 0; a < 3; ++a) rows.xyz[3 * row + a] += random.uniform(-0.05, 0.05);
    }
    if (kind != 0) options.moved = moved;
    std::vector<std::int64_t> removed, own;
    std::vector<double> more;
    Insertion in;
    if (random.below(2) == 0) {
      for (const std::int64_t id : rows.ids)
        if (random.below(25) == 0) removed.push_back(id);
      const std::uint64_t count = random.below(30);
      for (std::uint64_t k = 0; k < 3 * count; ++k) more.push_back(random.uniform());
      in.positions = Positions::rows(more.data(), count, 3);
      if (random.below(2) == 0)
        for (std::uint64_t k = 0; k < count; ++k)
          own.push_back(10000 * step + 5 * static_cast<std::int64_t>(count - k));
      in.ids = own;
      options.removed = removed;
      options.inserted = &in;
    }
    if (random.below(6) == 0) {  // another client steps in between: the base is lost, and that is mended
      auto theirs = other->open_scene("walk");
      ASSERT_TRUE(theirs.ok() && theirs->step_unmoved().ok());
      options.step = theirs->last_step().value() + 1;
    }
    const auto result = scene->step(rows.positions(), options);
    ASSERT_TRUE(result.ok()) << result.status().message();
    rows.follow(*result, more, {}, rows.ids.size() - removed.size() + more.size() / 3);
    if (options.want_parts) {
      ASSERT_EQ(result->parts, rows.parts);
    }
    rows.expect_held(*client);
    if (::testing::Test::HasFatalFailure()) return;
  }
}

TEST(Changes, TheLibraryKnowsWhatTheServiceHolds) {
  auto service = launch::Embedded::start(3, [](double) {});
  ASSERT_TRUE(service.ok()) << service.status().message();
  for (std::uint64_t seed = 1; seed <= 6 && !HasFatalFailure(); ++seed) walk(service->endpoint(), seed);
}

}  // namespace
}  // namespace rcb::client
