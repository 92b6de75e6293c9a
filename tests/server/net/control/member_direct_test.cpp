// Members whose shares go straight to the ranks: all of them or none, given up together, ordered when every rank has
// what every member brings it. The ranks are a plane that only notes what it is told.
#include <mutex>

#include <gtest/gtest.h>

#include "tests/server/net/harness.hpp"

namespace rcb::net::testing {
namespace {

using wire::FrameType;
using wire::Json;

constexpr const char* kSessions[] = {"00000000000000aa", "00000000000000bb"};
constexpr int kRanks = 3;

// Knows one scene, of ten particles on three ranks, whose first push is of step 7; notes the members' pushes.
class OneScene final : public Engine {
 public:
  void submit(Order order, std::function<void(Answer)> done) override {
    const std::lock_guard lock(mutex);
    const std::string command = order.request["command"];
    scene::Held held{.n = 10, .epoch = 3, .plan_version = 2, .plan_checksum = 5, .rank_counts = {4, 3, 3}};
    Answer answer;
    if (command == "scene.create") {
      if (std::exchange(created, true)) answer.status = Status(Code::already_exists, "it is there");
      scene::SceneOptions options;
      options.dims = 2;
      if (answer.status.ok()) answer.change = {"s", scene::Created{options, {}}};
    }
    if (command.starts_with("push")) {
      scene::Stepped stepped;
      stepped.report.step = last_step = order.request["step"].get<std::int64_t>();
      stepped.held = std::move(held);
      stepped.held.loads = std::make_shared<const partition::LoadSummary>();
      answer.change = {"s", std::move(stepped)};
    }
    if (command == "push.members") {
      pushed.push_back(order.request);
      for (int k = 0; k < 2; ++k)
        for (const char* name : {"changed_id", "place_id"}) answer.arrays.push_back({name, "<i8", {0}, {}});
      if (order.request.contains("cuts_known")) {
        answer.json["cuts"] = {{"epoch", 4}};
        for (const char* name : {"axes", "at", "id", "part_sizes"}) answer.arrays.push_back({name, "<i8", {0}, {}});
      }
    }
    done(std::move(answer));
  }

  std::mutex mutex;
  bool created = false;
  std::int64_t last_step = 0;
  std::vector<Json> pushed;
};

using Counts = std::vector<std::optional<std::uint64_t>>;

class Notes final : public DataPlane {
 public:
  struct Opened {
    PushTicket ticket;
    Counts counts;
  };
  void open(const PushTicket& ticket, std::span<const std::optional<std::uint64_t>> counts) override {
    const std::lock_guard lock(mutex);
    opened.push_back({ticket, {counts.begin(), counts.end()}});
  }
  void drop(const PushId& id) override {
    const std::lock_guard lock(mutex);
    dropped.push_back(id);
  }
  std::mutex mutex;
  std::vector<Opened> opened;
  std::vector<PushId> dropped;
};

class MemberDirect : public ::testing::Test {
 protected:
  MemberDirect() {
    ControlOptions options = TestService::defaults();
    options.ranks = kRanks;
    control_ = std::make_unique<Control>(loop_, options, engine_);
    EXPECT_TRUE(control_->listen_unix(path()).ok());
    control_->serve_data(plane_, "unix:" + path(), {"unix:/a", "unix:/b", "unix:/c"});
    control_->start();
    loop_.start();
  }
  ~MemberDirect() override { loop_.stop(); }
  std::string path() const { return directory_ / "s"; }

  void join(bool follow = true) {
    for (int k = 0; k < 2; ++k) {
      team_[k] = Client::on_unix(path());
      EXPECT_EQ(team_[k].hello("member", kSessions[k]).json["data"].size(), 3U);
      if (team_[k].call("scene.create", {{"scene", "s"}}).type == FrameType::reply) {
        team_[k].begin(kSessions[k], 7, 0, {{"slices", 0}});
        EXPECT_EQ(team_[k].receive_but_notices().json["report"]["step"], 7);
      }
      Received opened =
          team_[k].call("scene.open", {{"scene", "s"}, {"member", k}, {"members", 2}, {"follow", follow}});
      EXPECT_EQ(opened.json["membership"]["member"], k);
    }
  }
  void direct(int k, const std::vector<std::uint64_t>& counts, Json more = Json::object(), std::int64_t step = 8) {
    std::uint64_t n = 0;
    for (const std::uint64_t count : counts) n += count;
    Json begin{{"slices", 0},      {"order", "plan"},
               {"path", "direct"}, {"counts", counts},
               {"epoch", 3},       {"base_step", 7},
               {"ids", false},     {"places", true},     {"changes", true},
               {"attempt", 1},     {"plan", {{"version", 2}, {"checksum", wire::hex64(5)}}}};
    begin.update(more);
    team_[k].begin(kSessions[k], step, n, begin);
  }
  void by_ids(int k, std::uint64_t n, std::int64_t attempt = 2) {
    team_[k].begin(kSessions[k], 8, n, {{"ids", true}, {"changes", true}, {"attempt", attempt}});
    Json ids{{"attempt", attempt},
             {"arrays",
              {{{"name", "x"}, {"dtype", "<f8"}, {"shape", {n}}},
               {{"name", "y"}, {"dtype", "<f8"}, {"shape", {n}}},
               {{"name", "id"}, {"dtype", "<i8"}, {"shape", {n}}}}},
             {"command", "push.slice"},
             {"scene", "s"},
             {"session", kSessions[k]},
             {"step", 8},
             {"rank", 0},
             {"count", n}};
    team_[k].send(FrameType::request, ids, std::string(24 * n, '\0'));
  }
  void whole(int rank, std::uint64_t number, const Status& status = {}) {
    loop_.run([&] { control_->slice_reported(rank, {number, 0, status.ok(), status}); });
  }
  // Waits until what the members have sent was read.
  void settle() {
    for (Client& one : team_) EXPECT_EQ(one.call("status").type, FrameType::reply);
  }
  void refused(int k, const std::string& code, const std::string& word) {
    const Received answer = team_[k].receive_but_notices();
    EXPECT_EQ(answer.code(), code) << answer.message();
    EXPECT_NE(answer.message().find(word), std::string::npos) << answer.message();
  }
  std::size_t pushed() {
    const std::lock_guard lock(engine_.mutex);
    return engine_.pushed.size();
  }

  IoLoop loop_;
  Directory directory_;
  OneScene engine_;
  Notes plane_;
  std::unique_ptr<Control> control_;
  Client team_[2];
};

TEST_F(MemberDirect, AStepIsOrderedWhenEveryRankHasWhatEveryMemberBrings) {
  join();
  direct(0, {4, 0, 1});
  settle();
  ASSERT_EQ(plane_.opened.size(), 1U);
  const PushTicket& ticket = plane_.opened[0].ticket;
  EXPECT_EQ(ticket.terms.id, (PushId{"s", kSessions[0], 8, 1}));
  EXPECT_EQ(ticket.terms.plan, (PlanId{2, 5}));
  EXPECT_EQ(plane_.opened[0].counts, (Counts{4, std::nullopt, 1}));
  const std::uint64_t first = ticket.number;
  whole(0, first);
  direct(1, {0, 3, 2}, {{"step_seconds", 0.5}});
  settle();
  ASSERT_EQ(plane_.opened.size(), 2U);
  const std::uint64_t second = plane_.opened[1].ticket.number;
  whole(1, second);
  whole(2, second);
  EXPECT_EQ(pushed(), 0U);  // rank 2 still waits for the first one's
  whole(2, first);
  for (Client& one : team_) {
    const Received answer = one.receive_but_notices();
    EXPECT_EQ(answer.type, FrameType::reply) << answer.message();
    EXPECT_EQ(answer.json["arrays"].size(), 2U);
  }
  ASSERT_EQ(pushed(), 1U);
  const Json& order = engine_.pushed[0];
  EXPECT_EQ(order["staged"], Json({first, second}));
  EXPECT_EQ(order["order"], "plan");
  EXPECT_EQ(order["plan"]["version"], 2);
  EXPECT_EQ(order["n"], 10);
  EXPECT_EQ(order["ids"], false);
  EXPECT_EQ(order["places"], true);
  EXPECT_EQ(order["step_seconds"], 0.5);
  EXPECT_TRUE(plane_.dropped.empty());
  // The answer is lost: it is given again, and what comes to the ranks is dropped.
  direct(0, {4, 0, 1}, {{"attempt", 2}});
  EXPECT_EQ(team_[0].receive_but_notices().json["repeated"], true);
  settle();
  ASSERT_EQ(plane_.dropped.size(), 1U);
  EXPECT_EQ(plane_.dropped[0].attempt, 2);
  EXPECT_EQ(plane_.opened.size(), 2U);
}

TEST_F(MemberDirect, PlacesAreToldWhereAllAskForThem) {
  join();
  direct(0, {4, 3, 3}, {{"places", false}});
  direct(1, {0, 0, 0});
  settle();
  ASSERT_EQ(plane_.opened.size(), 1U);
  for (int rank = 0; rank < kRanks; ++rank) whole(rank, plane_.opened[0].ticket.number);
  EXPECT_EQ(team_[0].receive_but_notices().json["arrays"].size(), 1U);
  team_[1].receive_but_notices();
  EXPECT_EQ(engine_.pushed.at(0)["places"], false);
}

// The ranks tell them once; no cuts are known to all unless all name the same.
TEST_F(MemberDirect, CutsAreToldToThoseThatAskForThem) {
  const Json none = Json::object(), some{{"epoch", 3}, {"hash", "00000000000000ab"}};
  const Json no_cuts{{"epoch", 0}, {"hash", "0000000000000000"}};
  join();
  for (const auto& [first, second, ordered] :
       {std::array{some, Json(), some}, {some, some, some}, {some, none, no_cuts}, {none, some, no_cuts}}) {
    const auto step = static_cast<std::int64_t>(8 + pushed());
    plane_.opened.clear();
    direct(0, {4, 3, 3}, {{"cuts_known", first}, {"base_step", step - 1}}, step);
    direct(1, {0, 0, 0}, {{"cuts_known", second}, {"base_step", step - 1}}, step);
    settle();
    ASSERT_EQ(plane_.opened.size(), 1U);
    for (int rank = 0; rank < kRanks; ++rank) whole(rank, plane_.opened[0].ticket.number);
    for (int k = 0; k < 2; ++k) {
      const Received answer = team_[k].receive_but_notices();
      const bool asked = k == 0 || !second.is_null();
      EXPECT_EQ(answer.json.contains("cuts"), asked);
      EXPECT_EQ(answer.json["arrays"].size(), asked ? 6U : 2U);
    }
    EXPECT_EQ(engine_.pushed.back()["cuts_known"], ordered);
  }
}

TEST_F(MemberDirect, OneWithoutParticlesNeedNotSayWeights) {
  for (const int empty : {0, 1}) {
    SCOPED_TRACE(empty);
    join();
    const int full = 1 - empty;
    const std::int64_t step = engine_.last_step + 1;
    team_[empty].begin(kSessions[empty], step, 0, {{"ids", true}, {"slices", 0}});
    team_[full].begin(kSessions[full], step, 10, {{"ids", true}, {"weights", true}});
    Json slice{{"command", "push.slice"},
               {"scene", "s"},
               {"session", kSessions[full]},
               {"step", step},
               {"attempt", 1},
               {"rank", 0},
               {"count", 10}};
    for (const auto& [name, dtype] : {std::pair("x", "<f8"), {"y", "<f8"}, {"w", "<f8"}, {"id", "<i8"}})
      slice["arrays"].push_back({{"name", name}, {"dtype", dtype}, {"shape", {10}}});
    team_[full].send(FrameType::request, slice, std::string(std::size_t{4} * 8 * 10, '\0'));
    for (Client& one : team_) {
      const Received answer = one.receive_but_notices();
      EXPECT_EQ(answer.type, FrameType::reply) << answer.message();
    }
    ASSERT_EQ(pushed(), static_cast<std::size_t>(empty) + 1);
    EXPECT_EQ(engine_.pushed.back()["weights"], true);
    for (Client& one : team_) one.close();
  }
}

TEST_F(MemberDirect, OneThatHasNotMovedBringsNothing) {
  join();
  direct(0, {4, 3, 0}, {{"moved", "none"}, {"weights", true}});
  refused(0, "unsupported", "weights are replaced all together");
  direct(0, {4, 3, 0}, {{"moved", "none"}});
  direct(1, {0, 0, 3});
  settle();
  ASSERT_EQ(plane_.opened.size(), 1U);
  EXPECT_EQ(plane_.opened[0].ticket.terms.id.session, kSessions[1]);
  whole(2, plane_.opened[0].ticket.number);
  for (Client& one : team_) EXPECT_EQ(one.receive_but_notices().type, FrameType::reply);
  EXPECT_EQ(engine_.pushed.at(0)["moved_by"], Json({"none", "all"}));
  EXPECT_EQ(engine_.pushed.at(0)["moved"], "all");
  EXPECT_EQ(engine_.pushed.at(0)["base_step"], 7);
  for (int k = 0; k < 2; ++k)
    direct(k, k == 0 ? std::vector<std::uint64_t>{4, 3, 0} : std::vector<std::uint64_t>{0, 0, 3},
           {{"moved", "none"}, {"base_step", 8}}, 9);
  for (Client& one : team_) EXPECT_EQ(one.receive_but_notices().type, FrameType::reply);
  EXPECT_EQ(engine_.pushed.at(1)["moved"], "none");
  EXPECT_EQ(plane_.opened.size(), 1U);
}

TEST_F(MemberDirect, OneThatPushesByIdsBringsAllToDoSo) {
  join();
  direct(0, {4, 0, 1});
  settle();
  by_ids(1, 5);
  refused(0, "stale_plan", "member 1");
  settle();
  ASSERT_EQ(plane_.dropped.size(), 1U);
  EXPECT_EQ(plane_.dropped[0], (PushId{"s", kSessions[0], 8, 1}));
  whole(0, plane_.opened[0].ticket.number);  // too late to matter
  direct(0, {4, 0, 1}, {{"attempt", 3}});
  refused(0, "stale_plan", "by ids");
  by_ids(0, 5, 4);
  for (Client& one : team_) EXPECT_EQ(one.receive_but_notices().type, FrameType::reply);
  settle();
  EXPECT_FALSE(engine_.pushed.at(0).contains("staged"));
  EXPECT_EQ(engine_.pushed.at(0)["order"], "id");
  EXPECT_EQ(plane_.dropped.size(), 2U);
}

// A member whose connection to a rank was cut pushes again, long before anybody else notices.
TEST_F(MemberDirect, ANewerAttemptReplacesTheOlderOfTheSameMember) {
  join();
  direct(0, {4, 0, 1});
  direct(0, {4, 0, 1}, {{"attempt", 3}});
  refused(0, "aborted", "newer attempt");
  direct(0, {4, 0, 1}, {{"attempt", 2}});
  refused(0, "busy", "already");
  settle();
  ASSERT_EQ(plane_.opened.size(), 2U);
  ASSERT_EQ(plane_.dropped.size(), 2U);
  EXPECT_EQ(plane_.dropped[0], (PushId{"s", kSessions[0], 8, 1}));
  EXPECT_EQ(plane_.dropped[1], (PushId{"s", kSessions[0], 8, 2}));
  for (const int rank : {0, 2}) whole(rank, plane_.opened[0].ticket.number);  // too late to matter
  direct(1, {0, 3, 2});
  settle();
  for (const int rank : {1, 2}) whole(rank, plane_.opened[2].ticket.number);
  EXPECT_EQ(pushed(), 0U);
  by_ids(0, 5, 4);
  refused(0, "aborted", "newer attempt");
  refused(1, "stale_plan", "member 0");
  by_ids(0, 5, 5);
  refused(0, "aborted", "newer attempt");
  by_ids(1, 5);
  for (Client& one : team_) EXPECT_EQ(one.receive_but_notices().type, FrameType::reply);
  ASSERT_EQ(pushed(), 1U);
  EXPECT_EQ(engine_.pushed[0]["counts"], Json({10}));
  // One that doesn't fit ends the step where it leaves nobody in it.
  direct(0, {4, 0, 1}, {{"base_step", 8}}, 9);
  direct(0, {4, 0, 1}, {{"base_step", 7}, {"attempt", 2}}, 9);
  refused(0, "aborted", "newer attempt");
  refused(0, "base_lost", "step 7");
  direct(0, {4, 0, 1}, {{"base_step", 8}}, 10);
  settle();
  EXPECT_EQ(plane_.opened.back().ticket.terms.id.step, 10);
  for (const int rank : {0, 2}) whole(rank, plane_.opened.back().ticket.number);
  direct(1, {0, 3, 2}, {{"base_step", 8}}, 10);
  settle();
  for (const int rank : {1, 2}) whole(rank, plane_.opened.back().ticket.number);
  for (Client& one : team_) EXPECT_EQ(one.receive_but_notices().type, FrameType::reply);
}

TEST_F(MemberDirect, OneBringsFewAndAnotherInserts) {
  join();
  direct(0, {2, 0, 0}, {{"moved", "some"}, {"n", 7}, {"removed", 1}, {"slices", 1}});
  direct(1, {0, 0, 3}, {{"inserted", 2}, {"slices", 1}});
  settle();
  ASSERT_EQ(plane_.opened.size(), 2U);
  for (const auto& opened : plane_.opened) {
    const bool few = opened.ticket.terms.id.session == kSessions[0];
    EXPECT_EQ(opened.ticket.terms.moved, few ? Moved::some : Moved::all);
    whole(few ? 0 : 2, opened.ticket.number);
  }
  EXPECT_EQ(pushed(), 0U) << "what is removed and inserted has not come";
  const auto edit = [this](int k, const char* holds, std::uint64_t count, const Json& arrays, std::size_t bytes) {
    team_[k].send(FrameType::request,
                  {{"command", "push.slice"},
                   {"scene", "s"},
                   {"session", kSessions[k]},
                   {"step", 8},
                   {"attempt", 1},
                   {"holds", holds},
                   {"count", count},
                   {"arrays", arrays}},
                  std::string(bytes, '\0'));
  };
  edit(0, "removed", 1, {{{"name", "id"}, {"dtype", "<i8"}, {"shape", {1}}}}, 8);
  edit(1, "inserted", 2,
       {{{"name", "x"}, {"dtype", "<f8"}, {"shape", {2}}}, {{"name", "y"}, {"dtype", "<f8"}, {"shape", {2}}}}, 32);
  for (Client& one : team_) EXPECT_EQ(one.receive_but_notices().type, FrameType::reply);
  const Json& pushed = engine_.pushed.at(0);
  EXPECT_EQ(pushed["moved_by"], Json({"some", "all"}));
  EXPECT_EQ(pushed["moved"], "all");
  EXPECT_EQ(pushed["counts"], Json({2, 0, 0}));
  EXPECT_EQ(pushed["inserted"], 2);
  EXPECT_EQ(pushed["removed"], 1);
  EXPECT_EQ(pushed["inserted_ids"], false);
}

TEST_F(MemberDirect, SharedMemoryAndSlicesInOneStep) {
  join();
  const auto array = [](const char* name) { return Json{{"name", name}, {"number", 1}, {"offset", 0}, {"stride", 8}}; };
  const Json memory{array("x"), array("y"), array("row")};
  direct(0, {4, 0, 1}, {{"path", "shared"}, {"memory", memory}, {"sockets", {2, 1}}});
  refused(0, "invalid_argument", "sockets");
  direct(0, {4, 0, 1}, {{"path", "shared"}, {"memory", memory}, {"sockets", {1, 2}}});
  direct(1, {0, 3, 2}, {{"path", "shared"}, {"memory", memory}});
  settle();
  // Rank 1 holds nothing of member 0, rank 0 reads its particles from memory, and so do all ranks those of member 1.
  ASSERT_EQ(plane_.opened.size(), 1U);
  EXPECT_EQ(plane_.opened[0].counts, (Counts{std::nullopt, std::nullopt, 1}));
  EXPECT_EQ(pushed(), 0U);
  whole(2, plane_.opened[0].ticket.number);
  for (Client& one : team_) EXPECT_EQ(one.receive_but_notices().type, FrameType::reply);
  const Json& staged = engine_.pushed.at(0)["staged"];
  EXPECT_EQ(staged[0]["number"], plane_.opened[0].ticket.number);
  EXPECT_EQ(staged[0]["sockets"], Json({1, 2}));
  EXPECT_EQ(staged[1]["sockets"], Json::array());
}

TEST_F(MemberDirect, WhatDoesNotFitTheSceneIsRefusedAlone) {
  join();
  direct(1, {0, 3, 2});
  settle();
  const std::vector<std::uint64_t> mine{4, 0, 1};
  const Json other_plan{{"version", 1}, {"checksum", wire::hex64(5)}};
  direct(0, mine, {{"plan", other_plan}});
  refused(0, "stale_plan", "plan 1");
  direct(0, mine, {{"epoch", 2}});
  refused(0, "stale_plan", "epoch 2");
  direct(0, mine, {{"base_step", 6}});
  refused(0, "base_lost", "step 6");
  direct(0, mine, {{"base_step", nullptr}});
  refused(0, "invalid_argument", "base_step");
  direct(0, mine, {{"n", 6}});
  refused(0, "invalid_argument", "5 particles");
  direct(0, {4, 0});
  refused(0, "invalid_argument", "counts");
  direct(0, {4, 0, 4});
  refused(0, "stale_plan", "4 particles of rank 2");
  direct(0, mine, {{"ids", true}});
  refused(0, "unsupported", "without ids");
  direct(0, mine, {{"moved", "some"}, {"base_step", nullptr}});
  refused(0, "unsupported", "base_step");
  settle();
  EXPECT_EQ(plane_.dropped.size(), 9U);  // the other member's is not among them
  EXPECT_EQ(plane_.opened.size(), 1U);
  direct(0, {3, 0, 1});  // one is nobody's
  for (int k = 0; k < 2; ++k) refused(k, "stale_plan", "9 particles of the scene");
  direct(1, {0, 3, 2});
  direct(0, {3, 1, 1});
  for (int k = 0; k < 2; ++k) refused(k, "stale_plan", "3 particles of rank 0");
  settle();
  EXPECT_EQ(plane_.dropped.size(), 13U);
  EXPECT_EQ(pushed(), 0U);
}

TEST_F(MemberDirect, AShareThatARankLosesEndsTheStepForAll) {
  join();
  direct(0, {4, 0, 1});
  direct(1, {0, 3, 2});
  settle();
  ASSERT_EQ(plane_.opened.size(), 2U);
  const std::uint64_t number =
      plane_.opened[plane_.opened[0].ticket.terms.id.session == kSessions[1] ? 0 : 1].ticket.number;
  whole(1, number, {Code::aborted, "the data connection to rank 1 was lost"});
  for (int k = 0; k < 2; ++k) refused(k, "aborted", "member 1");
  settle();
  EXPECT_EQ(plane_.dropped.size(), 2U);
  // Then a member goes in the midst of its slices.
  direct(0, {4, 0, 1}, {{"attempt", 2}});
  direct(1, {0, 3, 2}, {{"attempt", 2}});
  settle();
  team_[1].close();
  refused(0, "aborted", "member 1");
  team_[0].call("status");
  EXPECT_EQ(plane_.dropped.size(), 4U);
}

TEST_F(MemberDirect, FewByIdsNeedThePartsOfTheLastStep) {
  join();
  const Json few{{"order", "id"}, {"slices", 0}, {"moved", "none"}, {"base_step", 7}};
  const auto begin = [&](std::int64_t attempt, const Json& more) {
    Json all = few;
    all.update(more);
    all["attempt"] = attempt;
    team_[0].begin(kSessions[0], 8, 4, all);
  };
  begin(1, {{"epoch", 2}});
  refused(0, "base_lost", "epoch 2");
  begin(2, Json::object());
  refused(0, "invalid_argument", "epoch");
  begin(3, {{"epoch", 3}, {"n", 3}});
  by_ids(1, 6);
  for (const int k : {0, 1}) refused(k, "invalid_argument", "9 particles of the scene, which has 10");
  begin(4, {{"epoch", 3}});
  by_ids(1, 6, 4);
  for (Client& one : team_) EXPECT_EQ(one.receive_but_notices().type, FrameType::reply);
  EXPECT_EQ(engine_.pushed.at(0)["moved_by"], Json({"none", "all"}));
  EXPECT_EQ(engine_.pushed.at(0)["moved"], "some");
  EXPECT_EQ(engine_.pushed.at(0)["n"], 10);
  EXPECT_EQ(engine_.pushed.at(0)["counts"], Json({6}));
}

TEST_F(MemberDirect, MembersThatDoNotFollowPushByIds) {
  join(false);
  direct(0, {4, 0, 1});
  refused(0, "unsupported", "follow");
}

}  // namespace
}  // namespace rcb::net::testing
