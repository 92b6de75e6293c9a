// Steps from memory that the client shares with the ranks of a real service.
#include <algorithm>
#include <barrier>
#include <numeric>
#include <span>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "client/launch/launch.hpp"
#include "client/lib/client.hpp"
#include "common/base/random.hpp"
#include "tests/client/launch/rows.hpp"

namespace rcb::client {
namespace {

constexpr std::size_t kCount = 500;

std::vector<double> random_rows(std::size_t count, std::uint64_t seed) {
  Random random(seed);
  std::vector<double> rows(3 * count);
  for (double& value : rows) value = random.uniform();
  return rows;
}

class SharedArraysTest : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    auto started = launch::Embedded::start(3, [](double) {});
    ASSERT_TRUE(started.ok()) << started.status().message();
    service_ = new launch::Embedded(std::move(*started));
  }
  static void TearDownTestSuite() { delete service_; }

  static Client connect(Path path = Path::automatic) {
    auto client = Client::connect({.endpoint = service_->endpoint(), .path = path});
    EXPECT_TRUE(client.ok()) << client.status().message();
    return std::move(*client);
  }
  static Scene scene(Client& client, const std::string& name) {
    EXPECT_TRUE(client.create_scene(name, {.parts = 5, .replace = true}).ok());
    auto opened = client.open_scene(name);
    EXPECT_TRUE(opened.ok()) << opened.status().message();
    return std::move(*opened);
  }
  // Expects the scene to be what a scene is to which `rows` are pushed through the endpoint.
  static void expect_positions(Client& client, const std::string& name, const std::vector<double>& rows) {
    const auto held = client.call("fetch", "{\"scene\":\"" + name + "\"}");
    ASSERT_TRUE(held.ok()) << held.status().message();
    const auto x = held->find("x")->f8();
    const auto z = held->find("z")->f8();
    ASSERT_EQ(x.size(), rows.size() / 3);
    for (std::size_t i = 0; i < x.size(); ++i) {
      ASSERT_EQ(x[i], rows[3 * i]) << i;
      ASSERT_EQ(z[i], rows[3 * i + 2]) << i;
    }
  }

  static launch::Embedded* service_;
};

launch::Embedded* SharedArraysTest::service_ = nullptr;

TEST_F(SharedArraysTest, AStepIsWhatTheGivenArraysHold) {
  Client client = connect();
  Scene rows_scene = scene(client, "rows");
  Scene axes_scene = scene(client, "axes");
  Scene single_scene = scene(client, "single");
  for (std::uint64_t step = 0; step < 4; ++step) {
    const auto values = random_rows(kCount, step);
    auto rows = rows_scene.position_rows(kCount);
    ASSERT_TRUE(rows.ok());
    std::copy(values.begin(), values.end(), rows->begin());
    auto done = rows_scene.step(Positions::rows(rows->data(), kCount, 3));
    ASSERT_TRUE(done.ok()) << done.status().message();
    EXPECT_EQ(done->report.way, "shared-memory");
    expect_positions(client, "rows", values);

    auto axes = axes_scene.position_axes(kCount);
    ASSERT_TRUE(axes.ok());
    ASSERT_EQ(axes->size(), 3U);
    std::vector<const double*> pointers;
    for (std::size_t a = 0; a < 3; ++a) {
      for (std::size_t i = 0; i < kCount; ++i) (*axes)[a][i] = values[3 * i + a];
      pointers.push_back((*axes)[a].data());
    }
    done = axes_scene.step(Positions::axes(pointers, kCount));
    ASSERT_TRUE(done.ok()) << done.status().message();
    EXPECT_EQ(done->report.way, "shared-memory");
    expect_positions(client, "axes", values);

    auto singles = single_scene.position_rows_f4(kCount);
    ASSERT_TRUE(singles.ok());
    std::vector<double> widened;
    for (std::size_t k = 0; k < values.size(); ++k) {
      (*singles)[k] = static_cast<float>(values[k]);
      widened.push_back(static_cast<double>((*singles)[k]));
    }
    done = single_scene.step(Positions::rows(singles->data(), kCount, 3));
    ASSERT_TRUE(done.ok()) << done.status().message();
    EXPECT_EQ(done->report.bytes, 12 * kCount);
    expect_positions(client, "single", widened);
  }
}

TEST_F(SharedArraysTest, OthersArraysAreCopiedWhereverTheyLie) {
  Client client = connect();
  Scene of = scene(client, "copied");
  const auto values = random_rows(kCount, 9);
  const std::vector<double> weights(kCount, 2);
  ASSERT_TRUE(of.step(Positions::rows(values.data(), kCount, 3), {.weights = weights}).ok());
  expect_positions(client, "copied", values);
  // Five numbers from particle to particle.
  std::vector<double> wide(5 * kCount);
  for (std::size_t i = 0; i < kCount; ++i)
    for (std::size_t a = 0; a < 3; ++a) wide[5 * i + a] = values[3 * i + a] + 1;
  Positions strided = Positions::rows(wide.data(), kCount, 3);
  strided.stride = 5;
  const auto done = of.step(strided, {.want_changes = true});
  ASSERT_TRUE(done.ok()) << done.status().message();
  EXPECT_EQ(done->report.way, "shared-memory");
  auto moved = values;
  for (double& value : moved) value += 1;
  expect_positions(client, "copied", moved);
}

TEST_F(SharedArraysTest, TheArraysGrowAndKeepWhatTheyHold) {
  Client client = connect();
  Scene of = scene(client, "grows");
  auto rows = of.position_rows(kCount);
  ASSERT_TRUE(rows.ok());
  auto values = random_rows(kCount, 1);
  std::copy(values.begin(), values.end(), rows->begin());
  ASSERT_TRUE(of.step(Positions::rows(rows->data(), kCount, 3)).ok());
  std::vector<std::int64_t> ids(10 * kCount);
  std::iota(ids.begin(), ids.end(), 0);
  for (std::size_t count = kCount + 100; count < 10 * kCount; count *= 2) {
    const auto more = random_rows(count - values.size() / 3, count);
    rows = of.position_rows(count);
    ASSERT_TRUE(rows.ok());
    EXPECT_TRUE(std::equal(values.begin(), values.end(), rows->begin()));
    std::copy(more.begin(), more.end(), rows->begin() + static_cast<std::ptrdiff_t>(values.size()));
    values.insert(values.end(), more.begin(), more.end());
    const auto done = of.step(Positions::rows(rows->data(), count, 3),
                              {.ids = std::span(ids).first(count), .inserted = more.size() / 3});
    ASSERT_TRUE(done.ok()) << done.status().message();
    EXPECT_EQ(done->report.way, "shared-memory");
    expect_positions(client, "grows", values);
  }
}

// Once ids are the solver's own, the ranks are told which row is whose.
TEST_F(SharedArraysTest, RowsOfOwnIdsThatComeAndGo) {
  Client client = connect();
  Random random(11);
  for (const bool weighted : {false, true}) {
    Scene of = scene(client, "own");
    Rows rows;
    rows.next_id = 7919;
    rows.add(kCount, random, weighted);
    for (int step = 0; step < 12; ++step) {
      StepOptions options{.want_changes = true};
      rows.move(random, 0.02);
      if (step > 0 && step % 3 != 2) rows.change(random, 20, options);
      options.ids = rows.ids;
      options.weights = rows.weights;
      const auto done = of.step(rows.positions(), options);
      ASSERT_TRUE(done.ok()) << done.status().message();
      EXPECT_EQ(done->report.way, "shared-memory");
      rows.note(*done);
      EXPECT_TRUE(rows.expect_held(client, "own"));
    }
  }
}

TEST_F(SharedArraysTest, ThePathIsTheOneThatWasNamed) {
  const auto values = random_rows(kCount, 3);
  for (const auto& [path, way] : {std::pair(Path::shared, "shared-memory"), std::pair(Path::direct, "sockets"),
                                  std::pair(Path::gateway, "endpoint")}) {
    Client client = connect(path);
    Scene of = scene(client, "named");
    const auto done = of.step(Positions::rows(values.data(), kCount, 3));
    ASSERT_TRUE(done.ok()) << done.status().message();
    EXPECT_EQ(done->report.way, way);
  }
}

TEST_F(SharedArraysTest, RowsWithIdsInAnotherOrderAreNotTakenForTheIds) {
  for (const Path path : {Path::shared, Path::gateway}) {
    Client client = connect(path);
    const auto values = random_rows(kCount, 4);
    Scene first = scene(client, "order");
    ASSERT_TRUE(first.step(Positions::rows(values.data(), kCount, 3)).ok());
    // Another Scene's rows are in falling order of the ids.
    auto other = client.open_scene("order");
    ASSERT_TRUE(other.ok());
    std::vector<double> falling;
    std::vector<std::int64_t> ids;
    for (std::size_t i = kCount; i-- > 0;) {
      ids.push_back(static_cast<std::int64_t>(i));
      falling.insert(falling.end(), values.begin() + static_cast<std::ptrdiff_t>(3 * i),
                     values.begin() + static_cast<std::ptrdiff_t>(3 * i + 3));
    }
    for (int step = 1; step < 3; ++step) {
      const auto done = other->step(Positions::rows(falling.data(), kCount, 3), {.step = step, .ids = ids});
      ASSERT_TRUE(done.ok()) << done.status().message();
      expect_positions(client, "order", values);
    }
    // The ids are still 0..n-1, so rows without are taken for them.
    const auto without = first.step(Positions::rows(values.data(), kCount, 3), {.step = 3});
    ASSERT_TRUE(without.ok()) << without.status().message();
    expect_positions(client, "order", values);
  }
}

// 300 scenes, one after another: more than a connection may share at a time.
TEST_F(SharedArraysTest, AClosedSceneSharesNoMore) {
  Client client = connect();
  const auto values = random_rows(10, 3);
  for (int k = 0; k < 300; ++k) {
    Scene of = scene(client, "closed");
    const auto done = of.step(Positions::rows(values.data(), 10, 3));
    ASSERT_TRUE(done.ok()) << done.status().message();
    ASSERT_EQ(done->report.way, "shared-memory") << k;
  }
}

TEST_F(SharedArraysTest, ASceneThatWasMadeAnewIsOpenedAgain) {
  for (const char* positions : {"every-step", "when-needed"}) {
    Client client = connect();
    ASSERT_TRUE(client.create_scene("anew", {.parts = 5, .positions = positions, .replace = true}).ok());
    auto before = client.open_scene("anew");
    const auto points = random_rows(kCount, 6);
    for (int step = 0; step < 2; ++step) ASSERT_TRUE(before->step(Positions::rows(points.data(), kCount, 3)).ok());
    ASSERT_TRUE(client.create_scene("anew", {.parts = 4, .dims = 2, .positions = positions, .replace = true}).ok());
    EXPECT_EQ(before->step(Positions::rows(points.data(), kCount, 3)).status().code(), Code::not_found);
    auto scene = client.open_scene("anew");
    ASSERT_TRUE(scene.ok()) << scene.status().message();
    EXPECT_EQ(scene->position_rows(kCount)->size(), 2 * kCount);
    const auto done = scene->step(Positions::rows(points.data(), kCount, 2));
    ASSERT_TRUE(done.ok()) << done.status().message();
    EXPECT_EQ(done->report.step, 0);
    EXPECT_EQ(before->step(Positions::rows(points.data(), kCount, 3)).status().code(), Code::not_found);
    ASSERT_TRUE(client.drop_scene("anew").ok());
    EXPECT_EQ(scene->step(Positions::rows(points.data(), kCount, 2)).status().code(), Code::not_found);
  }
}

TEST_F(SharedArraysTest, SeatsShareTheirsWithTheRanks) {
  constexpr int kSeats = 2;
  Client maker = connect();
  ASSERT_TRUE(maker.create_scene("team", {.parts = 6, .tolerance = 0.3, .replace = true}).ok());
  const auto begin = random_rows(kCount, 5);
  std::vector<std::vector<std::string>> ways(kSeats);
  std::barrier handed_over(kSeats);
  std::vector<std::int64_t> to_other[kSeats];  // by whom
  struct Leaver {                              // one that fails keeps nobody waiting
    std::barrier<>& barrier;
    ~Leaver() { barrier.arrive_and_drop(); }
  };
  const auto solve = [&](int seat) {
    const Leaver leaver{handed_over};
    Client client = connect(Path::shared);
    auto of = client.open_scene("team", {.seat = seat, .seats = kSeats});
    ASSERT_TRUE(of.ok()) << of.status().message();
    std::vector<std::int64_t> ids;
    for (std::size_t i = 0; i < kCount; ++i)
      if (static_cast<int>(i % kSeats) == seat) ids.push_back(static_cast<std::int64_t>(i));
    for (int step = 0; step < 12; ++step) {
      // Given arrays in every other step; else its own.
      std::vector<double> own(3 * ids.size());
      auto given = of->position_rows(ids.size());
      ASSERT_TRUE(given.ok());
      double* const to = step % 2 == 0 ? own.data() : given->data();
      for (std::size_t k = 0; k < ids.size(); ++k)
        for (std::size_t a = 0; a < 3; ++a)
          to[3 * k + a] = begin[3 * static_cast<std::size_t>(ids[k]) + a] + 0.01 * step * static_cast<double>(a + 1);
      const auto done = of->step(Positions::rows(to, ids.size(), 3), {.ids = ids});
      ASSERT_TRUE(done.ok()) << done.status().message();
      ways[static_cast<std::size_t>(seat)].push_back(done->report.way);
      auto& going = to_other[seat];
      going.clear();
      for (const LeavingRow& one : done->leaving) going.push_back(std::exchange(ids[one.row], -1));
      std::erase(ids, -1);
      handed_over.arrive_and_wait();
      ids.insert(ids.end(), to_other[1 - seat].begin(), to_other[1 - seat].end());
    }
  };
  std::thread other(solve, 1);
  solve(0);
  other.join();
  std::vector<double> end;
  for (std::size_t i = 0; i < kCount; ++i)
    for (std::size_t a = 0; a < 3; ++a) end.push_back(begin[3 * i + a] + 0.01 * 11 * static_cast<double>(a + 1));
  expect_positions(maker, "team", end);
  for (const auto& of_seat : ways) {
    EXPECT_EQ(std::count(of_seat.begin(), of_seat.end(), "shared-memory"), 12);
  }
}

}  // namespace
}  // namespace rcb::client
