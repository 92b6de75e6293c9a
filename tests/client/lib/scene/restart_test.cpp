// A service that dies and is started again, whose ranks hold no particles then: the next step brings all of them, and
// the caller hears what has changed since it was last told.
#include <algorithm>
#include <array>
#include <numeric>
#include <random>

#include <gtest/gtest.h>

#include "client/lib/client.hpp"
#include "common/base/random.hpp"
#include "tests/client/lib/fake_scene.hpp"

namespace rcb::client {
namespace {

using Fault = FakeScene::Fault;

constexpr int kParts = 5;
constexpr int kDims = 2;
constexpr std::size_t kParticles = 600;

std::int32_t part_of(std::int64_t id, std::int64_t step) {
  return static_cast<std::int32_t>((mix64(static_cast<std::uint64_t>(id)) + static_cast<std::uint64_t>(step) / 2) %
                                   kParts);
}

// x lies in the region of the particle's part.
double value_of(std::int64_t id, std::size_t axis, std::int64_t step) {
  if (axis == 0) return part_of(id, step) + (static_cast<double>(id) + 0.25) / 10000;
  return static_cast<double>(id) + 0.25 * static_cast<double>(axis) + 1000.5 * static_cast<double>(step);
}

FakeScene scene_that(Fault fault, std::vector<int> at) {
  FakeScene fake(kDims, kParts, 3);
  fake.position = value_of;
  fake.fault = [=](int push) { return std::find(at.begin(), at.end(), push) == at.end() ? Fault::none : fault; };
  return fake;
}

// A solver with ids of its own.
struct Solver {
  explicit Solver(FakeScene& scene, ConnectOptions options = {}) : fake(scene) {
    service = std::make_unique<FakeService>([&scene](Peer& peer, int) { scene.serve(peer); });
    options.endpoint = service->endpoint();
    client.emplace(Client::connect(options).value());
    pushed.emplace(client->open_scene("s").value());
    for (std::size_t i = 0; i < kParticles; ++i) ids.push_back(static_cast<std::int64_t>(9000 - 7 * i));
  }
  Positions at(std::int64_t step) {
    xyz.resize(kParticles * kDims);
    for (std::size_t i = 0; i < kParticles; ++i)
      for (std::size_t a = 0; a < kDims; ++a) xyz[i * kDims + a] = value_of(ids[i], a, step);
    return Positions::rows(xyz.data(), kParticles, kDims);
  }
  Result<StepResult> step(std::int64_t number, StepOptions options = {}) {
    options.ids = ids;
    options.want_changes = options.want_parts = true;
    return pushed->step(at(number), options);
  }
  // What must have been told after step `number`, where `before` was told last.
  void expect(const StepResult& result, std::int64_t number, std::int64_t before) const {
    std::vector<std::uint64_t> changed;
    for (std::size_t row = 0; row < kParticles; ++row) {
      ASSERT_EQ(result.parts[row], part_of(ids[row], number));
      if (before < 0 || part_of(ids[row], before) != part_of(ids[row], number)) changed.push_back(row);
    }
    ASSERT_EQ(result.changes.size(), changed.size());
    for (std::size_t k = 0; k < changed.size(); ++k) ASSERT_EQ(result.changes[k].row, changed[k]);
  }
  // What the script wrote may be read after this.
  void end() {
    pushed.reset();
    client.reset();
    service->stop();
  }

  FakeScene& fake;
  std::vector<std::int64_t> ids;
  std::vector<double> xyz;
  std::unique_ptr<FakeService> service;
  std::optional<Client> client;
  std::optional<Scene> pushed;
};

TEST(Restart, EveryStepIsCommittedAndToldOnceThroughAnyNumberOfDeaths) {
  for (const Fault fault : {Fault::die_before_commit, Fault::die_after_commit}) {
    FakeScene fake = scene_that(fault, {0, 3, 4, 8});
    Solver solver(fake);
    for (std::int64_t step = 0; step < 8; ++step) {
      const auto result = solver.step(step);
      ASSERT_TRUE(result.ok()) << result.status().message();
      EXPECT_EQ(result->report.step, step);
      solver.expect(*result, step, step - 1);
      if (HasFatalFailure()) return;
    }
    EXPECT_EQ(solver.pushed->last_step(), 7);
    solver.end();
    EXPECT_EQ(fake.restarts, fault == Fault::die_before_commit ? 4 : 3);
    EXPECT_EQ(fake.commits, 8);
    EXPECT_GE(fake.refills, 2);
  }
}

TEST(Restart, WeightsAreBroughtAgain) {
  FakeScene fake = scene_that(Fault::die_before_commit, {1});
  Solver solver(fake);
  std::vector<double> weights(kParticles);
  std::iota(weights.begin(), weights.end(), 0.5);
  StepOptions first;
  first.weights = weights;
  ASSERT_TRUE(solver.step(0, first).ok());
  const auto result = solver.step(1);
  ASSERT_TRUE(result.ok()) << result.status().message();
  solver.expect(*result, 1, 0);
  solver.end();
  EXPECT_EQ(fake.refills, 1);
  EXPECT_EQ(fake.weights, weights);
}

TEST(Restart, ASceneThatSomebodyReplacedIsNotGoneOnWith) {
  FakeScene fake = scene_that(Fault::none, {});
  fake.options = {{"incarnation", "00000000000000aa"}};
  fake.fault = [&fake](int push) {
    if (push == 1) fake.options["incarnation"] = "00000000000000bb";
    return push == 1 ? Fault::close_before_commit : Fault::none;
  };
  Solver solver(fake);
  ASSERT_TRUE(solver.step(0).ok());
  const Status status = solver.step(1).status();
  EXPECT_EQ(status.code(), Code::not_found);
  EXPECT_NE(status.message().find("is another one, made anew"), std::string::npos) << status.message();
}

}  // namespace
}  // namespace rcb::client
