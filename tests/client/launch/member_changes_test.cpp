// Members of a parallel solver whose particles come and go, over a real service: by every way the scene is what the
// solver has.
#include <algorithm>
#include <array>
#include <barrier>
#include <map>
#include <mutex>
#include <set>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "client/launch/launch.hpp"
#include "client/lib/client.hpp"
#include "client/lib/member.hpp"
#include "common/base/random.hpp"

namespace rcb::client {
namespace {

using Point = std::array<double, 3>;

constexpr int kRebalanced = 6;  // after this step

// Where all particles of the solver are. Its members hold disjoint sets of them.
struct Solver {
  explicit Solver(int members) : all_have_read(members) {}
  std::barrier<> all_have_read;  // what this step has done; then what is handed over
  std::mutex mutex;
  std::map<int, std::vector<std::int64_t>> handed_over;  // to each member
  std::map<std::int64_t, int> keeper;                    // after the last step
  std::map<std::int64_t, Point> at;
  std::set<std::string> ways;
};

class ChangingMember {
 public:
  ChangingMember(Solver& solver, int member, int members, Path path, const std::string& endpoint)
      : solver_(solver), member_(member), members_(members), random_(static_cast<std::uint64_t>(100 + member)) {
    auto client = Client::connect({.endpoint = endpoint, .path = path});
    EXPECT_TRUE(client.ok()) << client.status().message();
    client_.emplace(std::move(*client));
  }

  void solve(int steps) {
    auto scene = MemberScene::open(*client_, "team", {.member = member_, .members = members_, .follow = true});
    EXPECT_TRUE(scene.ok()) << scene.status().message();
    if (!scene.ok()) return solver_.all_have_read.arrive_and_drop();
    {
      const std::lock_guard lock(solver_.mutex);
      for (const auto& [id, at] : solver_.at)
        if (id % members_ == member_) ids_.push_back(id);
    }
    for (int step = 0; step < steps && !::testing::Test::HasFatalFailure(); ++step) {
      solver_.all_have_read.arrive_and_wait();
      push(*scene, step);
      // The places that members know are then wrong, so all push the next step by ids.
      if (step == kRebalanced && member_ == 0) {
        EXPECT_TRUE(client_->call("rebalance", R"({"scene":"team","method":"bands-x"})").ok());
      }
    }
    {
      const std::lock_guard lock(solver_.mutex);
      for (const std::int64_t id : ids_) solver_.keeper[id] = member_;
    }
    solver_.all_have_read.arrive_and_drop();
  }

 private:
  void push(MemberScene& scene, int step) {
    MemberStepOptions options;
    std::vector<std::uint64_t> moved;
    std::vector<std::int64_t> removed;
    std::vector<double> inserted, rows;
    const std::uint64_t kind = step == 0 ? 0 : random_.below(4);
    {
      const std::lock_guard lock(solver_.mutex);
      for (std::size_t row = 0; row < ids_.size(); ++row) {
        Point& at = solver_.at.at(ids_[row]);
        if (kind == 0 || (kind == 1 && random_.below(4) == 0)) {
          for (double& x : at) x += random_.uniform(-0.02, 0.02);
          moved.push_back(row);
        }
        rows.insert(rows.end(), at.begin(), at.end());
        if (step > 0 && random_.below(12) == 0) removed.push_back(ids_[row]);
      }
    }
    if (kind == 1) options.moved = moved;
    options.unmoved = kind == 2;
    if (kind == 3) options.moved = std::span<const std::uint64_t>();
    std::reverse(moved.begin(), moved.end());  // any order
    const std::size_t count = step == 0 ? 0 : random_.below(9);
    for (std::size_t k = 0; k < 3 * count; ++k) inserted.push_back(random_.uniform());
    const Insertion in{.positions = Positions::rows(inserted.data(), count, 3), .ids = {}, .weights = {}};
    options.removed = removed;
    options.want_parts = true;
    if (count > 0) options.inserted = &in;
    const auto done = scene.step(Positions::rows(rows.data(), ids_.size(), 3), ids_, options);
    ASSERT_TRUE(done.ok()) << done.status().message();
    ASSERT_EQ(done->inserted_ids.size(), count);
    const auto cuts = scene.cuts();
    ASSERT_TRUE(cuts.ok()) << cuts.status().message();
    EXPECT_EQ(cuts->epoch(), done->report.epoch);
    const std::set<std::int64_t> gone(removed.begin(), removed.end());
    std::vector<std::int64_t> all = ids_, stay;
    all.insert(all.end(), done->inserted_ids.begin(), done->inserted_ids.end());
    ASSERT_EQ(done->parts.size(), all.size());
    std::vector<std::pair<std::uint64_t, int>> leaving, told;
    for (const LeavingRow& one : done->leaving) told.emplace_back(one.row, one.to);
    for (std::size_t row = 0; row < all.size(); ++row) {
      const int to = cuts::seat_of_part(done->parts[row], done->report.parts, members_);
      if (gone.contains(all[row])) continue;
      if (to != member_) leaving.emplace_back(row, to);
      if (to == member_) stay.push_back(all[row]);
    }
    EXPECT_EQ(told, leaving);
    {
      const std::lock_guard lock(solver_.mutex);
      if (step > 1 && step != kRebalanced + 1) solver_.ways.insert(done->report.way);
      for (const std::int64_t id : removed) solver_.at.erase(id);
      for (std::size_t k = 0; k < count; ++k)
        solver_.at[done->inserted_ids[k]] = {inserted[3 * k], inserted[3 * k + 1], inserted[3 * k + 2]};
      for (const LeavingRow& one : done->leaving) solver_.handed_over[one.to].push_back(all[one.row]);
    }
    solver_.all_have_read.arrive_and_wait();
    const std::lock_guard lock(solver_.mutex);
    ids_ = std::move(stay);
    for (const std::int64_t id : std::exchange(solver_.handed_over[member_], {})) ids_.push_back(id);
  }

  Solver& solver_;
  int member_;
  int members_;
  Random random_;
  std::optional<Client> client_;
  std::vector<std::int64_t> ids_;
};

TEST(ChangingMembers, TheSceneIsWhatTheyHave) {
  auto service = launch::Embedded::start(3, [](double) {});
  ASSERT_TRUE(service.ok()) << service.status().message();
  auto control = Client::connect({.endpoint = service->endpoint()});
  ASSERT_TRUE(control.ok());
  for (const Path path : {Path::gateway, Path::direct, Path::shared})
    for (const int members : {1, 3, 4}) {
      ASSERT_TRUE(control->create_scene("team", {.parts = 6, .tolerance = 0.2, .replace = true}).ok());
      Solver solver(members);
      Random random(7);
      for (std::int64_t id = 0; id < 600; ++id) solver.at[id] = {random.uniform(), random.uniform(), random.uniform()};
      std::vector<std::thread> threads;
      for (int k = 0; k < members; ++k)
        threads.emplace_back([&, k] { ChangingMember(solver, k, members, path, service->endpoint()).solve(14); });
      for (std::thread& one : threads) one.join();
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
        EXPECT_EQ(solver.keeper[id[k]], cuts::seat_of_part(assigned->find("part")->i4()[k], 6, members)) << id[k];
      EXPECT_EQ(solver.ways.contains("endpoint"), path == Path::gateway) << "not in other steps";
    }
}

}  // namespace
}  // namespace rcb::client
