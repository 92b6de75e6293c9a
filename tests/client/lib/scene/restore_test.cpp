// A service that dies and is started again without its scenes: the scene is made anew and gets all particles, whatever
// the step would have brought, and the caller hears what has changed since it was last told.
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
  fake.part_of = part_of;
  fake.fault = [=](int push) { return std::find(at.begin(), at.end(), push) == at.end() ? Fault::none : fault; };
  return fake;
}

// A solver with ids of its own.
struct Solver {
  explicit Solver(FakeScene& scene, ConnectOptions options = {}) : fake(scene) {
    service = std::make_unique<FakeService>([&scene](Peer& peer, int) { scene.serve(peer); });
    options.endpoint = service->endpoint();
    options.on_notice = [this](const std::string& text) { notices.push_back(text); };
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
    options.ids = number == 0 ? std::span<const std::int64_t>(ids) : std::span<const std::int64_t>();
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
  std::vector<std::string> notices;
  std::unique_ptr<FakeService> service;
  std::optional<Client> client;
  std::optional<Scene> pushed;
};

TEST(Restore, EveryStepHasOneReportAndItsNumberThroughAnyNumberOfDeaths) {
  for (const Fault fault : {Fault::die_before_commit, Fault::die_after_commit}) {
    FakeScene fake = scene_that(fault, {0, 3, 4, 8});
    Solver solver(fake);
    int recreated = 0;
    for (std::int64_t step = 0; step < 8; ++step) {
      const auto result = solver.step(step);
      ASSERT_TRUE(result.ok()) << result.status().message();
      EXPECT_EQ(result->report.step, step);
      recreated += result->report.scene_recreated ? 1 : 0;
      solver.expect(*result, step, step - 1);
      if (HasFatalFailure()) return;
    }
    EXPECT_EQ(solver.pushed->last_step(), 7);
    solver.end();
    EXPECT_EQ(fake.restarts, 4);
    EXPECT_EQ(recreated, 3) << "two deaths in a row, one loss";
    EXPECT_EQ(fake.commits, fault == Fault::die_before_commit ? 8 : 12);
  }
}

TEST(Restore, TheSceneIsMadeWithTheOptionsThatTheServiceSaidLast) {
  FakeScene fake = scene_that(Fault::die_before_commit, {1});
  fake.options = {{"tolerance", "inf"}, {"policy", "cost"}, {"part_sizes", {1, 2, 3, 4, 5}}};
  Solver solver(fake);
  ASSERT_TRUE(solver.step(0).ok() && solver.step(1).ok());
  solver.end();
  ASSERT_EQ(fake.created.size(), 1U);
  const protocol::Json& made = fake.created[0];
  EXPECT_EQ(made["parts"], kParts);
  EXPECT_EQ(made["dims"], kDims);
  EXPECT_EQ(made["tolerance"], "inf");
  EXPECT_EQ(made["policy"], "cost");
  EXPECT_EQ(made["part_sizes"], fake.options["part_sizes"]);
  EXPECT_EQ(made["recreated"], true);
  EXPECT_FALSE(made.contains("replace")) << "whoever was quicker has made it just so";
  EXPECT_NE(std::find_if(solver.notices.begin(), solver.notices.end(),
                         [](const std::string& text) { return text.find("made anew") != std::string::npos; }),
            solver.notices.end());
}

// A drop that the service refuses leaves the scene as it was, also what is known of it.
TEST(Restore, ASceneWhoseDropWasRefusedIsMadeAnew) {
  std::vector<protocol::Json> created;
  FakeService service([&](Peer& peer, int number) {
    if (!peer.greet(1, "instance " + std::to_string(number))) return;
    while (const auto request = peer.receive()) {
      if (request->type == protocol::FrameType::goodbye) return;
      const auto command = request->json["command"].get<std::string>();
      if (number == 0 && command == "scene.open") return;  // the service dies
      if (command == "scene.create") created.push_back(request->json);
      if (command == "scene.drop")
        peer.fail(*request, {Code::busy, "another client has it open"});
      else if (command == "scene.open" && created.size() < 2)
        peer.fail(*request, {Code::not_found, "no such scene"});
      else
        peer.reply(*request, {{"scene", "s"}, {"n", 0}, {"dims", 2}, {"parts", 7}, {"ranks", 1}, {"epoch", 0}});
    }
  });
  {
    auto client = Client::connect({.endpoint = service.endpoint()});
    ASSERT_TRUE(client.ok());
    ASSERT_TRUE(client->create_scene("s", {.parts = 7, .dims = 2}).ok());
    EXPECT_EQ(client->drop_scene("s").code(), Code::busy);
    const auto scene = client->open_scene("s");
    EXPECT_TRUE(scene.ok()) << scene.status().message();
  }
  service.stop();
  ASSERT_EQ(created.size(), 2U);
  EXPECT_EQ(created[1]["parts"], 7);
  EXPECT_EQ(created[1]["recreated"], true);
}

TEST(Restore, PartSizesThatCameAsAnArrayAreKept) {
  FakeScene fake = scene_that(Fault::die_before_commit, {1});
  fake.long_part_sizes = {5, 4, 3, 2, 1};
  Solver solver(fake);
  ASSERT_TRUE(solver.step(0).ok() && solver.step(1).ok());
  solver.end();
  ASSERT_EQ(fake.created.size(), 1U);
  EXPECT_EQ(fake.created[0]["part_sizes"], protocol::Json(fake.long_part_sizes));
}

TEST(Restore, WeightsAndRowsThatStoodStillAreBroughtAsTheyWere) {
  FakeScene fake = scene_that(Fault::die_before_commit, {1});
  Solver solver(fake);
  std::vector<double> weights(kParticles);
  std::iota(weights.begin(), weights.end(), 0.5);
  StepOptions first;
  first.weights = weights;
  ASSERT_TRUE(solver.step(0, first).ok());
  const std::array<std::uint64_t, 2> moved{3, 70};
  StepOptions few;
  few.moved = moved;
  const auto result = solver.step(1, few);
  ASSERT_TRUE(result.ok()) << result.status().message();
  solver.expect(*result, 1, 0);
  solver.end();
  EXPECT_EQ(fake.weights, weights);
}

TEST(Restore, AStepWithoutAllPositionsSaysWhatItLacksAndTheNextOneGoesOn) {
  FakeScene fake = scene_that(Fault::die_before_commit, {1, 3});
  Solver solver(fake);
  ASSERT_TRUE(solver.step(0).ok());
  for (int again = 0; again < 2; ++again) {
    const Status status = solver.pushed->step_unmoved().status();
    EXPECT_EQ(status.code(), Code::base_lost) << status.message();
    EXPECT_NE(status.message().find("has lost the particles of scene 's'"), std::string::npos) << status.message();
    EXPECT_NE(status.message().find("of 600 particles this push has the positions of 0"), std::string::npos)
        << status.message();
  }
  const auto result = solver.step(1);
  ASSERT_TRUE(result.ok()) << result.status().message();
  EXPECT_TRUE(result->report.scene_recreated);
  solver.expect(*result, 1, 0);
  // Other particles than were lost are a new beginning.
  EXPECT_EQ(solver.pushed->step_unmoved().status().code(), Code::base_lost);
  std::vector<double> fewer;
  for (std::int64_t row = 0; row < 10; ++row)
    for (std::size_t a = 0; a < kDims; ++a) fewer.push_back(value_of(row, a, 2));
  const auto others = solver.pushed->step(Positions::rows(fewer.data(), 10, kDims), {.want_changes = true});
  ASSERT_TRUE(others.ok()) << others.status().message();
  EXPECT_EQ(others->changes.size(), 10U);
}

TEST(Restore, WhoDoesNotWantItIsTold) {
  FakeScene fake = scene_that(Fault::die_before_commit, {1});
  ConnectOptions plain;
  plain.outlive = false;
  Solver solver(fake, plain);
  ASSERT_TRUE(solver.step(0).ok());
  const Status status = solver.step(1).status();
  EXPECT_EQ(status.code(), Code::not_found);
  EXPECT_NE(status.message().find("no scene 's'"), std::string::npos) << status.message();
  solver.end();
  EXPECT_TRUE(fake.created.empty());
}

}  // namespace
}  // namespace rcb::client
