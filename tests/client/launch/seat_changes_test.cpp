// Seats of a parallel solver whose particles come and go, over a real service: by every way the scene is what the
// solver has.
#include <algorithm>
#include <array>
#include <barrier>
#include <map>
#include <mutex>
#include <set>
#include <string>
#include <thread>
#include <tuple>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "client/launch/launch.hpp"
#include "client/lib/client.hpp"
#include "common/base/random.hpp"

namespace rcb::client {
namespace {

using Point = std::array<double, 3>;

constexpr int kRebalanced = 6;      // after this step
constexpr std::int64_t kAll = 600;  // particles at the start

// Where all particles of the solver are. Its seats hold disjoint sets of them.
struct Solver {
  explicit Solver(int seats, bool is_rebalanced = true) : all_have_read(seats), rebalanced(is_rebalanced) {
    Random random(7);
    for (std::int64_t id = 0; id < kAll; ++id) at[id] = {random.uniform(), random.uniform(), random.uniform()};
  }
  std::barrier<> all_have_read;  // what this step has done; then what is handed over
  bool rebalanced;               // at kRebalanced
  std::mutex mutex;
  std::map<int, std::vector<std::int64_t>> handed_over;  // to each seat
  std::map<std::int64_t, int> keeper;                    // after the last step
  std::map<std::int64_t, Point> at;
  std::set<std::string> ways;
  std::vector<StepReport> reports;
};

class ChangingSeat {
 public:
  ChangingSeat(Solver& solver, int seat, int seats, Path path, const std::string& endpoint)
      : solver_(solver), seat_(seat), seats_(seats), random_(static_cast<std::uint64_t>(100 + seat)) {
    auto client = Client::connect({.endpoint = endpoint, .path = path});
    EXPECT_TRUE(client.ok()) << client.status().message();
    client_.emplace(std::move(*client));
  }

  void solve(int steps) {
    auto scene = client_->open_scene("team", {.seat = seat_, .seats = seats_});
    EXPECT_TRUE(scene.ok()) << scene.status().message();
    if (!scene.ok()) return solver_.all_have_read.arrive_and_drop();
    {
      const std::lock_guard lock(solver_.mutex);
      for (const auto& [id, at] : solver_.at)
        if (id % seats_ == seat_) ids_.push_back(id);
    }
    for (int step = 0; step < steps && !::testing::Test::HasFatalFailure(); ++step) {
      solver_.all_have_read.arrive_and_wait();
      push(*scene, step);
      if (step == kRebalanced && seat_ == 0 && solver_.rebalanced) {
        EXPECT_TRUE(client_->call("rebalance", R"({"scene":"team","method":"bands-x"})").ok());
      }
    }
    {
      const std::lock_guard lock(solver_.mutex);
      for (const std::int64_t id : ids_) solver_.keeper[id] = seat_;
    }
    solver_.all_have_read.arrive_and_drop();
  }

 private:
  void push(Scene& scene, int step) {
    std::vector<std::int64_t> removed;
    std::vector<double> rows;
    StepOptions options{.want_parts = true};
    {
      const std::lock_guard lock(solver_.mutex);
      const bool moves = step == 0 || random_.below(4) > 0;
      std::vector<std::int64_t> stay;
      for (const std::int64_t id : ids_) (step > 0 && random_.below(12) == 0 ? removed : stay).push_back(id);
      for (const std::int64_t id : removed) solver_.at.erase(id);
      ids_ = std::move(stay);
      options.removed = removed.size();
      options.inserted = step == 0 ? 0 : random_.below(9);
      for (std::uint64_t k = 0; k < options.inserted; ++k) {
        ids_.push_back(kAll + seats_ * new_++ + seat_);
        solver_.at[ids_.back()] = {random_.uniform(), random_.uniform(), random_.uniform()};
      }
      for (const std::int64_t id : ids_) {
        Point& at = solver_.at.at(id);
        for (double& x : at) x += moves ? random_.uniform(-0.02, 0.02) : 0;
        rows.insert(rows.end(), at.begin(), at.end());
      }
    }
    options.ids = ids_;
    const auto done = scene.step(Positions::rows(rows.data(), ids_.size(), 3), options);
    ASSERT_TRUE(done.ok()) << done.status().message();
    const auto cuts = scene.cuts();
    ASSERT_TRUE(cuts.ok()) << cuts.status().message();
    EXPECT_EQ(cuts->epoch(), done->report.epoch);
    ASSERT_EQ(done->parts.size(), ids_.size());
    std::vector<std::int64_t> stay;
    std::vector<std::pair<std::uint64_t, int>> leaving, told;
    for (const LeavingRow& one : done->leaving) told.emplace_back(one.row, one.to);
    for (std::size_t row = 0; row < ids_.size(); ++row) {
      const int to = cuts::seat_of_part(done->parts[row], done->report.parts, seats_);
      if (to != seat_) leaving.emplace_back(row, to);
      if (to == seat_) stay.push_back(ids_[row]);
    }
    EXPECT_EQ(told, leaving);
    {
      const std::lock_guard lock(solver_.mutex);
      solver_.ways.insert(done->report.way);
      if (seat_ == 0) solver_.reports.push_back(done->report);
      for (const LeavingRow& one : done->leaving) solver_.handed_over[one.to].push_back(ids_[one.row]);
    }
    solver_.all_have_read.arrive_and_wait();
    const std::lock_guard lock(solver_.mutex);
    ids_ = std::move(stay);
    for (const std::int64_t id : std::exchange(solver_.handed_over[seat_], {})) ids_.push_back(id);
    std::ranges::sort(ids_);  // whoever was faster
  }

  Solver& solver_;
  int seat_;
  int seats_;
  Random random_;
  std::optional<Client> client_;
  std::vector<std::int64_t> ids_;
  std::int64_t new_ = 0;  // particles that it has made
};

void solve(Solver& solver, int seats, Path path, const std::string& endpoint) {
  std::vector<std::thread> threads;
  for (int k = 0; k < seats; ++k)
    threads.emplace_back([&, k] { ChangingSeat(solver, k, seats, path, endpoint).solve(14); });
  for (std::thread& one : threads) one.join();
}

TEST(ChangingSeats, TheSceneIsWhatTheyHave) {
  auto service = launch::Embedded::start(3, [](double) {});
  ASSERT_TRUE(service.ok()) << service.status().message();
  auto control = Client::connect({.endpoint = service->endpoint()});
  ASSERT_TRUE(control.ok());
  for (const Path path : {Path::gateway, Path::direct, Path::shared})
    for (const int seats : {1, 3, 4}) {
      ASSERT_TRUE(control->create_scene("team", {.parts = 6, .tolerance = 0.2, .replace = true}).ok());
      Solver solver(seats);
      solve(solver, seats, path, service->endpoint());
      const auto held = control->call("fetch", "{\"scene\":\"team\"}");
      ASSERT_TRUE(held.ok()) << held.status().message();
      const auto id = held->find("id")->i8();
      ASSERT_EQ(id.size(), solver.at.size());
      std::size_t i = 0;
      for (const auto& [one, at] : solver.at) {
        EXPECT_EQ(id[i], one);
        EXPECT_EQ((Point{held->find("x")->f8()[i], held->find("y")->f8()[i], held->find("z")->f8()[i]}), at) << one;
        ++i;
      }
      const auto assigned = control->call("assign", "{\"scene\":\"team\"}");
      ASSERT_TRUE(assigned.ok()) << assigned.status().message();
      ASSERT_EQ(solver.keeper.size(), solver.at.size());
      for (std::size_t k = 0; k < id.size(); ++k)
        EXPECT_EQ(solver.keeper[id[k]], cuts::seat_of_part(assigned->find("part")->i4()[k], 6, seats)) << id[k];
      const char* way = path == Path::gateway ? "endpoint" : path == Path::direct ? "sockets" : "shared-memory";
      EXPECT_EQ(solver.ways, std::set<std::string>{way});
    }
}

// What comes and goes in a step needs no positions, and leaves the history that it leaves with them.
TEST(ChangingSeats, AreCountedLikeThoseThatStay) {
  auto service = launch::Embedded::start(3, [](double) {});
  ASSERT_TRUE(service.ok()) << service.status().message();
  auto control = Client::connect({.endpoint = service->endpoint()});
  ASSERT_TRUE(control.ok());
  for (const int seats : {1, 4}) {
    SCOPED_TRACE(seats);
    Solver sent(seats, false), counted(seats, false);
    for (const auto& [positions, solver] : {std::pair{"every-step", &sent}, {"when-needed", &counted}}) {
      ASSERT_TRUE(
          control->create_scene("team", {.parts = 6, .tolerance = 0.2, .positions = positions, .replace = true}).ok());
      solve(*solver, seats, Path::automatic, service->endpoint());
    }
    EXPECT_EQ(sent.at, counted.at);
    EXPECT_EQ(sent.keeper, counted.keeper);
    ASSERT_EQ(sent.reports.size(), counted.reports.size());
    int flowed = 0, told = 0;
    for (std::size_t k = 0; k < sent.reports.size(); ++k) {
      const StepReport &one = sent.reports[k], &other = counted.reports[k];
      EXPECT_EQ(std::tuple(one.n, one.inserted, one.removed, one.epoch, one.moved, one.strangers, one.axes_flipped),
                std::tuple(other.n, other.inserted, other.removed, other.epoch, other.moved, other.strangers,
                           other.axes_flipped));
      EXPECT_EQ(std::tuple(one.error_before, one.error, one.imbalance, one.repartitioned, one.reason),
                std::tuple(other.error_before, other.error, other.imbalance, other.repartitioned, other.reason));
      EXPECT_EQ(other.sent, other.repartitioned);
      flowed += !other.sent && other.inserted > 0 && other.removed > 0 ? 1 : 0;
      told += other.sent ? 1 : 0;
    }
    EXPECT_GT(flowed, 3);
    EXPECT_GT(told, 1);
  }
}

}  // namespace
}  // namespace rcb::client
