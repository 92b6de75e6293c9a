// The library against a real service whose ranks are killed: a random run of steps of every kind, in which positions,
// ids, weights and parts are what the solver believes after each, and the history is that of an undisturbed run.
#include <array>
#include <deque>
#include <fstream>
#include <random>
#include <thread>

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <signal.h>
#include <unistd.h>

#include "client/launch/launch.hpp"
#include "client/lib/client.hpp"
#include "common/base/random.hpp"
#include "tests/client/launch/rows.hpp"
#include "tests/support/directory.hpp"

namespace rcb::client {
namespace {

// A service with a supervisor, in a folder of its own.
class Supervised {
 public:
  explicit Supervised(int ranks) {
    launch::SuperviseOptions options;
    options.endpoint = endpoint();
    options.data_dir = folder_ / "data";
    options.ranks = ranks;
    const Status started = launch::start_detached(options, [](double) {});
    EXPECT_TRUE(started.ok()) << started.message();
    mpirun_ = parent_of(rank0());
    supervisor_ = parent_of(mpirun_);
  }
  ~Supervised() { EXPECT_TRUE(launch::stop_service(endpoint(), 30).ok()); }
  std::string endpoint() const { return "unix:" + (folder_ / "s"); }

  // kill -9 of one rank; nothing where there is none just now.
  void kill_one(Random& random) const {
    std::vector<pid_t> ranks;
    for (const pid_t job : children_of(supervisor_))
      for (const pid_t rank : children_of(job)) ranks.push_back(rank);
    if (!ranks.empty()) ::kill(ranks[random.below(ranks.size())], SIGKILL);
  }

 private:
  pid_t rank0() const {
    ConnectOptions where;
    where.endpoint = endpoint();
    auto client = Client::connect(where);
    EXPECT_TRUE(client.ok()) << client.status().message();
    return nlohmann::json::parse(client->call("status")->json)["pid"].get<pid_t>();
  }
  static pid_t parent_of(pid_t pid) {
    std::ifstream in("/proc/" + std::to_string(pid) + "/status");
    for (std::string line; std::getline(in, line);)
      if (line.starts_with("PPid:")) return std::stoi(line.substr(5));
    return 0;
  }
  static std::vector<pid_t> children_of(pid_t pid) {
    std::vector<pid_t> found;
    std::ifstream in("/proc/" + std::to_string(pid) + "/task/" + std::to_string(pid) + "/children");
    for (pid_t child = 0; in >> child;) found.push_back(child);
    return found;
  }

  const testing::Directory folder_;
  pid_t mpirun_ = 0;
  pid_t supervisor_ = 0;
};

// What a step brings.
struct Pushed {
  Rows rows;
  StepOptions options;  // of the counts and what is wanted
  bool weights = false;

  Result<StepResult> by(Scene& scene) {
    options.ids = rows.ids;
    if (weights) options.weights = rows.weights;
    return scene.step(rows.positions(), options);
  }
};

// rows: as the step before left them; gets those of the step.
Pushed choose(Rows& rows, Random& random) {
  Pushed pushed;
  pushed.options.want_changes = true;
  const bool changes = random.below(2) == 0;
  pushed.weights = changes || random.below(3) == 0;
  if (random.below(3) != 0) rows.move(random, 0.05);
  if (pushed.weights)
    for (double& weight : rows.weights) weight = random.uniform(0.5, 2);
  if (changes) rows.change(random, 30, pushed.options);
  pushed.rows = rows;
  return pushed;
}

TEST(Outlive, AStepThatIsCommittedIsNotTakenForAnother) {
  Supervised service(2);
  auto client = Client::connect({.endpoint = service.endpoint()});
  ASSERT_TRUE(client.ok()) << client.status().message();
  ASSERT_TRUE(client->create_scene("twice", {.parts = 4}).ok());
  auto one = client->open_scene("twice");
  auto other = client->open_scene("twice");
  ASSERT_TRUE(one.ok() && other.ok());
  std::vector<double> xyz(300);
  for (std::size_t i = 0; i < xyz.size(); ++i) xyz[i] = static_cast<double>(i * i % 101);
  const auto positions = Positions::rows(xyz.data(), 100, 3);
  ASSERT_TRUE(one->step(positions).ok());
  EXPECT_EQ(other->step(positions).status().code(), Code::stale_step);
  StepOptions back;
  back.step = 0;
  EXPECT_EQ(one->step(positions, back).status().code(), Code::stale_step);
  EXPECT_TRUE(one->step(positions).ok());
}

// Rows without ids of their own, so that the memory is shared again with the ranks of the new service.
TEST(Outlive, AnInsertionAfterARestartGoesOnWithTheScene) {
  Supervised service(2);
  auto client = Client::connect({.endpoint = service.endpoint(), .path = Path::shared});
  ASSERT_TRUE(client.ok()) << client.status().message();
  ASSERT_TRUE(client->create_scene("grows", {.parts = 4}).ok());
  auto scene = client->open_scene("grows");
  ASSERT_TRUE(scene.ok());
  Random random(1);
  Rows rows;
  rows.add(100, random, false);
  ASSERT_TRUE(scene->step(rows.positions()).ok());
  service.kill_one(random);
  rows.add(2, random, false);
  const auto grown = scene->step(rows.positions(), {.ids = rows.ids, .inserted = 2});
  ASSERT_TRUE(grown.ok()) << grown.status().message();
  EXPECT_EQ(grown->report.n, 102U);
  EXPECT_EQ(grown->report.error_before.has_value(), true);
  EXPECT_EQ(grown->report.way, "shared-memory");
}

// Nobody has a weight to bring at the restart.
TEST(Outlive, ASceneThatWasEmptyKeepsItsWeights) {
  Supervised service(2);
  Random random(1);
  Rows two;
  two.add(2, random, true);
  const Positions none = Positions::rows(two.xyz.data(), 0, 3);
  for (const bool at_once : {true, false}) {
    auto client = Client::connect({.endpoint = service.endpoint()});
    ASSERT_TRUE(client.ok()) << client.status().message();
    ASSERT_TRUE(client->create_scene("s", {.parts = 2, .replace = true}).ok());
    auto scene = client->open_scene("s");
    ASSERT_TRUE(scene.ok());
    ASSERT_TRUE(scene->step(two.positions(), {.ids = two.ids, .weights = two.weights}).ok());
    const auto emptied = scene->step(none, {.removed = 2});
    ASSERT_TRUE(emptied.ok()) << emptied.status().message();
    service.kill_one(random);
    if (!at_once) {
      const auto empty = scene->step(none);
      ASSERT_TRUE(empty.ok()) << empty.status().message();
    }
    const auto grown =
        scene->step(two.positions(), {.ids = two.ids, .weights = two.weights, .inserted = 2, .want_changes = true});
    ASSERT_TRUE(grown.ok()) << grown.status().message();
    two.note(*grown);
    EXPECT_TRUE(two.expect_held(*client, "s"));
  }
}

TEST(Outlive, ARunOfStepsOfEveryKindIsWhatTheSolverBelieves) {
  const std::uint64_t seed = std::random_device{}();
  SCOPED_TRACE("seed " + std::to_string(seed));
  Random random(seed);
  Supervised service(3);
  ConnectOptions where;
  where.endpoint = service.endpoint();
  where.path = std::array{Path::gateway, Path::direct, Path::shared}[seed % 3];
  auto client = Client::connect(where);
  ASSERT_TRUE(client.ok()) << client.status().message();
  ASSERT_TRUE(client->create_scene("walk", {.parts = 6, .tolerance = 0.1, .part_sizes = {1, 2, 1, 1, 1, 3}}).ok());
  auto scene = client->open_scene("walk");
  ASSERT_TRUE(scene.ok());
  Rows rows;
  rows.next_id = 7;
  rows.add(400, random, true);
  std::deque<Pushed> steps(1);
  steps[0] = {rows, {.want_changes = true}, true};
  int verified = 0;
  for (std::int64_t step = 0; step <= 40; ++step) {
    SCOPED_TRACE(::testing::Message() << "step " << step);
    if (step > 0) steps.push_back(choose(rows, random));
    std::thread killer;
    if (step % 10 == 5) {  // four times; before the push or in the middle of it
      const auto delay = std::chrono::microseconds(random.below(2) * random.below(2000));
      killer = std::thread([&service, delay, chance = random.next()] {
        std::this_thread::sleep_for(delay);
        Random which(chance);
        service.kill_one(which);
      });
    }
    const auto result = steps.back().by(*scene);
    if (killer.joinable()) killer.join();
    ASSERT_TRUE(result.ok()) << result.status().message();
    EXPECT_EQ(result->report.step, step);
    rows.note(*result);
    verified += rows.expect_held(*client, "walk") ? 1 : 0;
    if (HasFailure()) return;
  }
  EXPECT_GE(verified, 37);
  // The same steps undisturbed.
  ASSERT_TRUE(client->create_scene("calm", {.parts = 6, .tolerance = 0.1, .part_sizes = {1, 2, 1, 1, 1, 3}}).ok());
  auto calm = client->open_scene("calm");
  for (Pushed& step : steps) {
    const auto result = step.by(*calm);
    ASSERT_TRUE(result.ok()) << result.status().message();
  }
  const auto told = [&client](const char* name) {
    std::vector<std::string> lines;
    const auto read = client->history(name, {}, [&lines](const StepReport& report) {
      lines.push_back(fmt::format("{} {} {} {} {} {} {} {} {} {} {}", report.step, report.epoch, report.n,
                                  report.error_before.value_or(-1), report.error, report.imbalance,
                                  report.repartitioned, report.reason, report.moved, report.inserted, report.removed));
      return Status();
    });
    EXPECT_TRUE(read.ok()) << read.status().message();
    return lines;
  };
  EXPECT_EQ(told("walk"), told("calm"));
  const auto hash = [&client](const std::string& name) {
    return nlohmann::json::parse(client->call("scene.show", "{\"scene\":\"" + name + "\"}")->json)["hash"];
  };
  EXPECT_EQ(hash("walk"), hash("calm"));
}

}  // namespace
}  // namespace rcb::client
