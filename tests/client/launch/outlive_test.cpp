// The library against a real service whose ranks are killed: a random run of steps of every kind, in which positions,
// ids, weights and parts are what the solver believes after each, and the history is that of an undisturbed run.
#include <array>
#include <deque>
#include <fstream>
#include <map>
#include <numeric>
#include <random>
#include <thread>

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <signal.h>
#include <unistd.h>

#include "client/launch/launch.hpp"
#include "client/lib/client.hpp"
#include "client/lib/member.hpp"
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

// What the solver believes, by row.
struct WeightedRows : Rows {
  // False: the service has lost the particles since the step.
  bool held(Client& client) const {
    const auto reply = client.call("fetch", "{\"scene\":\"walk\"}");
    if (reply.status().code() == Code::not_found) return false;
    EXPECT_TRUE(reply.ok()) << reply.status().message();
    if (!reply) return false;
    const auto id = reply->find("id")->i8();
    const auto x = reply->find("x")->f8();
    const auto w = reply->find("w")->f8();
    const auto part = reply->find("part")->i4();
    EXPECT_EQ(id.size(), ids.size());
    std::map<std::int64_t, std::tuple<double, double, std::int32_t>> there;
    for (std::size_t i = 0; i < id.size(); ++i) there[id[i]] = {x[i], w[i], part[i]};
    std::size_t wrong = 0;
    for (std::size_t row = 0; row < ids.size(); ++row)
      wrong += there[ids[row]] == std::tuple(xyz[3 * row], weights[row], parts[row]) ? 0U : 1U;
    EXPECT_EQ(wrong, 0U);
    return true;
  }
};

// What a step asks for, beside the positions.
struct Change {
  std::vector<std::uint64_t> moved;
  std::vector<std::int64_t> removed;
  std::vector<double> more, more_weights, all_weights;
  Insertion in;
  StepOptions options;
};

void choose(Change& change, WeightedRows& rows, Random& random) {
  const auto kind = random.below(3);  // all, few, none
  for (std::uint64_t row = 0; row < rows.ids.size(); ++row) {
    if (kind == 2 || (kind == 1 && random.below(9) != 0)) continue;
    change.moved.push_back(row);
    for (std::size_t a = 0; a < 3; ++a) rows.xyz[3 * row + a] += random.uniform(-0.05, 0.05);
  }
  if (kind > 0) change.options.moved = change.moved;
  if (kind == 0 && random.below(3) == 0) {
    for (double& weight : rows.weights) weight = random.uniform(0.5, 2);
    change.all_weights = rows.weights;
    change.options.weights = change.all_weights;
  }
  change.options.want_changes = true;
  if (random.below(2) == 0) return;
  for (const std::int64_t id : rows.ids)
    if (random.below(25) == 0) change.removed.push_back(id);
  for (std::uint64_t k = random.below(30); k > 0; --k) {
    change.more_weights.push_back(random.uniform(0.5, 2));
    for (int a = 0; a < 3; ++a) change.more.push_back(random.uniform());
  }
  change.in.positions = Positions::rows(change.more.data(), change.more_weights.size(), 3);
  change.in.weights = change.more_weights;
  change.options.removed = change.removed;
  change.options.inserted = &change.in;
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
  std::vector<double> xyz(300);
  for (std::size_t i = 0; i < xyz.size(); ++i) xyz[i] = static_cast<double>(i * i % 101);
  const std::vector<double> more{1, 2, 3, 4, 5, 6};
  ASSERT_TRUE(scene->step(Positions::rows(xyz.data(), 100, 3)).ok());
  Random random(1);
  service.kill_one(random);
  Insertion in;
  in.positions = Positions::rows(more.data(), 2, 3);
  const auto grown = scene->step(Positions::rows(xyz.data(), 100, 3), {.inserted = &in});
  ASSERT_TRUE(grown.ok()) << grown.status().message();
  EXPECT_EQ(grown->report.n, 102U);
  EXPECT_EQ(grown->report.error_before.has_value(), true);
  EXPECT_EQ(grown->report.way, "shared-memory");
}

// Nobody has a weight to bring at the restart.
TEST(Outlive, ASceneThatWasEmptyKeepsItsWeights) {
  Supervised service(2);
  const std::vector<double> xyz{1, 2, 3, 4, 5, 6}, weights{1, 7};
  const std::vector<std::int64_t> all{0, 1};
  const Insertion in{.positions = Positions::rows(xyz.data(), 2, 3), .ids = {}, .weights = weights};
  const Positions none = Positions::rows(xyz.data(), 0, 3);
  Random random(1);
  for (const bool at_once : {true, false}) {
    auto client = Client::connect({.endpoint = service.endpoint()});
    ASSERT_TRUE(client.ok()) << client.status().message();
    const auto weights_held = [&](const char* scene) {
      const auto held = client->call("fetch", "{\"scene\":\"" + std::string(scene) + "\"}");
      EXPECT_TRUE(held.ok()) << held.status().message();
      const Array* array = held ? held->find("w") : nullptr;
      return array == nullptr ? std::vector<double>() : std::vector<double>(array->f8().begin(), array->f8().end());
    };
    ASSERT_TRUE(client->create_scene("one", {.parts = 2, .replace = true}).ok());
    ASSERT_TRUE(client->create_scene("team", {.parts = 2, .replace = true}).ok());
    auto one = client->open_scene("one");
    auto team = MemberScene::open(*client, "team", {.follow = true});
    ASSERT_TRUE(one.ok() && team.ok());
    MemberStepOptions first, last, inserting;
    first.weights = weights;
    last.removed = all;
    inserting.inserted = &in;
    ASSERT_TRUE(one->step(Positions::rows(xyz.data(), 2, 3), {.weights = weights}).ok());
    ASSERT_TRUE(team->step(Positions::rows(xyz.data(), 2, 3), all, first).ok());
    ASSERT_TRUE(one->step_unmoved({.removed = all}).ok());
    ASSERT_TRUE(team->step(Positions::rows(xyz.data(), 2, 3), all, last).ok());
    service.kill_one(random);
    if (!at_once) {
      const auto empty = one->step(none);
      ASSERT_TRUE(empty.ok()) << empty.status().message();
      const auto empty_team = team->step(none, {});
      ASSERT_TRUE(empty_team.ok()) << empty_team.status().message();
    }
    const auto grown = one->step(none, {.inserted = &in});
    ASSERT_TRUE(grown.ok()) << grown.status().message();
    EXPECT_EQ(weights_held("one"), weights);
    const auto grown_team = team->step(none, {}, inserting);
    ASSERT_TRUE(grown_team.ok()) << grown_team.status().message();
    EXPECT_EQ(weights_held("team"), weights);
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
  WeightedRows rows;
  for (int i = 0; i < 400; ++i) rows.ids.push_back(7 * i);
  for (int i = 0; i < 400; ++i) rows.weights.push_back(random.uniform(0.5, 2));
  for (int k = 0; k < 1200; ++k) rows.xyz.push_back(random.uniform());
  StepOptions first;
  first.ids = rows.ids;
  first.weights = rows.weights;
  first.want_parts = true;
  auto begun = scene->step(rows.positions(), first);
  ASSERT_TRUE(begun.ok()) << begun.status().message();
  rows.parts = begun->parts;
  const WeightedRows start = rows;
  std::deque<Change> changes;
  std::deque<std::vector<double>> positions;
  int verified = 0;
  for (std::int64_t step = 1; step <= 40; ++step) {
    SCOPED_TRACE(::testing::Message() << "step " << step);
    Change& change = changes.emplace_back();
    choose(change, rows, random);
    positions.push_back(rows.xyz);
    std::thread killer;
    if (step % 10 == 5) {  // four times; before the push or in the middle of it
      const auto delay = std::chrono::microseconds(random.below(2) * random.below(2000));
      killer = std::thread([&service, delay, chance = random.next()] {
        std::this_thread::sleep_for(delay);
        Random which(chance);
        service.kill_one(which);
      });
    }
    const auto result = scene->step(rows.positions(), change.options);
    if (killer.joinable()) killer.join();
    ASSERT_TRUE(result.ok()) << result.status().message();
    EXPECT_EQ(result->report.step, step);
    rows.follow(*result, change.more, change.more_weights,
                rows.ids.size() - change.removed.size() + change.more_weights.size());
    verified += rows.held(*client) ? 1 : 0;
    if (HasFailure()) return;
  }
  EXPECT_GE(verified, 36);
  // The same steps undisturbed.
  ASSERT_TRUE(client->create_scene("calm", {.parts = 6, .tolerance = 0.1, .part_sizes = {1, 2, 1, 1, 1, 3}}).ok());
  auto calm = client->open_scene("calm");
  first.ids = start.ids;
  first.weights = start.weights;
  ASSERT_TRUE(calm.ok() && calm->step(start.positions(), first).ok());
  for (std::size_t k = 0; k < changes.size(); ++k) {
    const auto result =
        calm->step(Positions::rows(positions[k].data(), positions[k].size() / 3, 3), changes[k].options);
    ASSERT_TRUE(result.ok()) << "step " << k + 1 << ": " << result.status().message();
  }
  const auto told = [&client](const char* name) {
    std::vector<std::string> lines;
    const auto read = client->history(name, {}, [&lines](const StepReport& report) {
      lines.push_back(fmt::format("{} {} {} {} {} {} {} {} {} {} {} {}", report.step, report.epoch, report.n,
                                  report.error_before.value_or(-1), report.error, report.imbalance,
                                  report.repartitioned, report.reason, report.moved, report.inserted, report.removed,
                                  report.first_id.value_or(-1)));
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
