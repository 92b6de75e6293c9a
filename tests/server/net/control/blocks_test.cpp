// Blocks that go straight to the ranks, of one client and of seats: who is told of them, what fits together, and the
// order that they make when every rank has what each brings it. The ranks are a plane that only notes what it is told.
#include <mutex>

#include <gtest/gtest.h>

#include "tests/server/net/harness.hpp"

namespace rcb::net::testing {
namespace {

using wire::FrameType;
using wire::Json;

constexpr const char* kSessions[] = {"00000000000000aa", "00000000000000bb"};
constexpr int kRanks = 3;

// Knows one scene, which has ten particles after every push.
class OneScene final : public Engine {
 public:
  void submit(Order order, std::function<void(Answer)> done) override {
    const std::lock_guard lock(mutex);
    const std::string command = order.request["command"];
    Answer answer;
    if (command == "scene.create") {
      if (std::exchange(created, true)) answer.status = Status(Code::already_exists, "it is there");
      scene::SceneOptions options;
      options.dims = 2;
      if (answer.status.ok()) answer.change = {"s", scene::Created{options, {}}};
    }
    if (command == "push") {
      scene::Stepped stepped;
      stepped.report.step = last_step = order.request["step"].get<std::int64_t>();
      stepped.report.positions_step = last_step;
      stepped.held = {.n = 10, .weights = weights, .ids = ids, .epoch = 3};
      stepped.held.loads = std::make_shared<const partition::LoadSummary>();
      answer.change = {"s", std::move(stepped)};
      pushed.push_back(order.request);
      slices = std::move(order.slices);
      if (order.request.contains("cuts_known")) {
        answer.json["cuts"] = {{"epoch", 4}};
        for (const char* name : {"axes", "at", "id", "part_sizes"}) answer.arrays.push_back({name, "<i8", {0}, {}});
      }
    }
    done(std::move(answer));
  }

  std::mutex mutex;
  bool created = false;
  bool weights = false;
  bool ids = false;
  std::int64_t last_step = 0;
  std::vector<Json> pushed;
  std::vector<Slice> slices;  // of the last push
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

Json memory_of(const std::vector<const char*>& names) {
  Json memory = Json::array();
  for (const char* name : names) memory.push_back({{"name", name}, {"number", 1}, {"offset", 0}, {"stride", 8}});
  return memory;
}

class Blocks : public ::testing::Test {
 protected:
  Blocks() {
    ControlOptions options = TestService::defaults();
    options.ranks = kRanks;
    control_ = std::make_unique<Control>(loop_, options, engine_);
    EXPECT_TRUE(control_->listen_unix(path()).ok());
    control_->serve_data(plane_, "unix:" + path(), {"unix:/a", "unix:/b", "unix:/c"});
    control_->start();
    loop_.start();
  }
  ~Blocks() override { loop_.stop(); }
  std::string path() const { return directory_ / "s"; }

  // The scene has had its first push, of step 7.
  void connect(int k) {
    team_[k] = Client::on_unix(path());
    EXPECT_EQ(team_[k].hello("seat", kSessions[k]).json["data"].size(), 3U);
    if (team_[k].call("scene.create", {{"scene", "s"}}).type != FrameType::reply) return;
    team_[k].push(7, 0);
    EXPECT_EQ(team_[k].receive_but_notices().json["report"]["step"], 7);
    engine_.pushed.clear();
  }
  void join() {
    for (int k = 0; k < 2; ++k) {
      connect(k);
      const Received opened = team_[k].call("scene.open", {{"scene", "s"}, {"seat", k}, {"seats", 2}});
      EXPECT_EQ(opened.json["seat"]["seat"], k);
    }
  }
  void direct(int k, const std::vector<std::uint64_t>& counts, const Json& more = Json::object(),
              std::int64_t step = 8) {
    std::uint64_t n = 0;
    for (const std::uint64_t count : counts) n += count;
    Json begin{{"way", "sockets"}, {"counts", counts}, {"ids", true}};
    begin.update(more);
    team_[k].push(step, n, begin);
  }
  // Through the endpoint.
  void endpoint(int k, std::uint64_t n, const Json& more = Json::object(), std::int64_t step = 8) {
    Json push{{"command", "push"}, {"scene", "s"}, {"step", step}, {"attempt", 1}, {"n", n}, {"ids", true}};
    push.update(more);
    const bool weights = more.value("weights", false);
    for (const auto& [name, dtype] : {std::pair("x", "<f8"), {"y", "<f8"}, {"w", "<f8"}, {"id", "<i8"}})
      if (n > 0 && (*name != 'w' || weights))
        push["arrays"].push_back({{"name", name}, {"dtype", dtype}, {"shape", {n}}});
    team_[k].send(FrameType::request, push, std::string((weights ? 32 : 24) * n, '\0'));
  }
  void whole(int rank, std::uint64_t number, const Status& status = {}) {
    loop_.run([&] { control_->slice_reported(rank, {number, 0, status.ok(), status}); });
  }
  // Waits until what the clients have sent was read.
  void settle() {
    for (Client& one : team_) EXPECT_EQ(one.call("status").type, FrameType::reply);
  }
  void refused(int k, const std::string& code, const std::string& word) {
    const Received answer = team_[k].receive_but_notices();
    EXPECT_EQ(answer.code(), code) << answer.message();
    EXPECT_NE(answer.message().find(word), std::string::npos) << answer.message();
  }
  void all_done(std::int64_t step = 8) {
    for (Client& one : team_) {
      const Received answer = one.receive_but_notices();
      EXPECT_EQ(answer.json.value("/report/step"_json_pointer, Json()), step) << answer.message();
    }
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

TEST_F(Blocks, AStepIsOrderedWhenEveryRankHasWhatEverySeatBrings) {
  join();
  direct(0, {4, 0, 1}, {{"drifted", 3}, {"dtype", "<f4"}});
  settle();
  ASSERT_EQ(plane_.opened.size(), 1U);
  const PushTicket& ticket = plane_.opened[0].ticket;
  EXPECT_EQ(ticket.terms.id, (PushId{"s", kSessions[0], 8, 1}));
  EXPECT_TRUE(ticket.terms.ids);
  EXPECT_EQ(plane_.opened[0].counts, (Counts{4, std::nullopt, 1}));
  const std::uint64_t first = ticket.number;
  whole(0, first);
  direct(1, {0, 3, 2}, {{"step_seconds", 0.5}, {"drifted", 1}});
  settle();
  ASSERT_EQ(plane_.opened.size(), 2U);
  const std::uint64_t second = plane_.opened[1].ticket.number;
  whole(1, second);
  whole(2, second);
  EXPECT_EQ(pushed(), 0U);  // rank 2 still waits for the first one's
  whole(2, first);
  all_done();
  ASSERT_EQ(pushed(), 1U);
  const Json& order = engine_.pushed[0];
  const Json blocks{
      {{"seat", 0}, {"n", 5}, {"way", "sockets"}, {"dtype", "<f4"}, {"counts", {4, 0, 1}}, {"number", first}},
      {{"seat", 1}, {"n", 5}, {"way", "sockets"}, {"dtype", "<f8"}, {"counts", {0, 3, 2}}, {"number", second}}};
  EXPECT_EQ(order["blocks"], blocks);
  for (const auto& [name, value] : std::map<std::string, Json>{
           {"n", 10}, {"seats", 2}, {"ids", true}, {"weights", false}, {"step_seconds", 0.5}, {"drifted", 4}})
    EXPECT_EQ(order[name], value) << name;
  EXPECT_TRUE(plane_.dropped.empty());
  // The answer is lost: the report is told again, and what comes to the ranks is dropped.
  direct(0, {4, 0, 1}, {{"attempt", 2}});
  const Received again = team_[0].receive_but_notices();
  EXPECT_EQ(again.json.value("repeated", false), true) << again.message();
  EXPECT_EQ(again.json.value("/report/step"_json_pointer, Json()), 8);
  settle();
  ASSERT_EQ(plane_.dropped.size(), 1U);
  EXPECT_EQ(plane_.dropped[0].attempt, 2);
  EXPECT_EQ(plane_.opened.size(), 2U);
}

// The ranks tell them once; no cuts are known to all unless all name the same.
TEST_F(Blocks, CutsAreToldToThoseThatAskForThem) {
  const Json none = Json::object(), some{{"epoch", 3}, {"hash", "00000000000000ab"}};
  const Json no_cuts{{"epoch", 0}, {"hash", "0000000000000000"}};
  join();
  for (const auto& [first, second, ordered] :
       {std::array{some, Json(), some}, {some, some, some}, {some, none, no_cuts}, {none, some, no_cuts}}) {
    const auto step = static_cast<std::int64_t>(8 + pushed());
    endpoint(0, 10, {{"cuts_known", first}}, step);
    endpoint(1, 0, {{"cuts_known", second}}, step);
    for (int k = 0; k < 2; ++k) {
      const Received answer = team_[k].receive_but_notices();
      EXPECT_EQ(answer.json["report"]["step"], step);
      const bool asked = k == 0 || !second.is_null();
      EXPECT_EQ(answer.json.contains("cuts"), asked);
      EXPECT_EQ(answer.json.value("arrays", Json::array()).size(), asked ? 4U : 0U);
    }
    EXPECT_EQ(engine_.pushed.back()["cuts_known"], ordered);
  }
}

TEST_F(Blocks, OneWithoutRowsNeedNotSayWeights) {
  engine_.weights = true;
  for (const int empty : {0, 1}) {
    SCOPED_TRACE(empty);
    join();
    const std::int64_t step = engine_.last_step + 1;
    endpoint(empty, 0, Json::object(), step);
    endpoint(1 - empty, 10, {{"weights", true}, {"drifted", 2}}, step);
    all_done(step);
    const Json& order = engine_.pushed.back();
    EXPECT_EQ(order["weights"], true);
    EXPECT_EQ(order["drifted"], 2);
    ASSERT_EQ(order["blocks"].size(), 1U);
    EXPECT_EQ(order["blocks"][0]["seat"], 1 - empty);
    ASSERT_EQ(engine_.slices.size(), 1U);
    EXPECT_EQ(engine_.slices[0].seat, 1 - empty);
    for (Client& one : team_) one.close();
  }
}

TEST_F(Blocks, EachSeatTakesItsOwnWay) {
  join();
  const Json shared{{"way", "shared-memory"}, {"memory", memory_of({"x", "y", "id", "row"})}};
  const auto with = [&](Json more) {
    more.update(shared);
    return more;
  };
  direct(0, {4, 0, 1}, with({{"sockets", {2, 1}}}));
  refused(0, "invalid_argument", "sockets");
  direct(0, {4, 0, 1}, with({{"sockets", {1, 2}}}));
  endpoint(1, 5);
  settle();
  // Rank 0 reads its rows from memory, and there are none for rank 1.
  ASSERT_EQ(plane_.opened.size(), 1U);
  EXPECT_EQ(plane_.opened[0].counts, (Counts{std::nullopt, std::nullopt, 1}));
  EXPECT_EQ(pushed(), 0U);
  whole(2, plane_.opened[0].ticket.number);
  all_done();
  const Json& order = engine_.pushed.at(0);
  const Json& block = order["blocks"][0];
  EXPECT_EQ(block["way"], "shared-memory");
  EXPECT_EQ(block["session"], kSessions[0]);
  EXPECT_EQ(block["memory"], shared["memory"]);
  EXPECT_EQ(block["counts"], Json({4, 0, 1}));
  EXPECT_EQ(block["sockets"], Json({1, 2}));
  EXPECT_EQ(block["number"], plane_.opened[0].ticket.number);
  EXPECT_EQ(order["blocks"][1], (Json{{"seat", 1}, {"n", 5}, {"way", "endpoint"}, {"dtype", "<f8"}}));
  ASSERT_EQ(engine_.slices.size(), 1U);
  EXPECT_TRUE(engine_.slices[0].seat == 1 && engine_.slices[0].count == 5);
  for (int k = 0; k < 2; ++k) direct(k, {4, 0, 1}, with(Json::object()), 9);
  all_done(9);
  EXPECT_EQ(engine_.pushed.at(1)["blocks"][1]["sockets"], Json::array());
}

// A seat whose connection to a rank was cut pushes again, long before anybody else notices.
TEST_F(Blocks, ANewerAttemptReplacesTheOlderOfTheSameSeat) {
  join();
  direct(0, {4, 0, 1});
  direct(0, {4, 0, 1}, {{"attempt", 3}});
  refused(0, "aborted", "newer attempt");
  direct(0, {4, 0, 1}, {{"attempt", 2}});
  refused(0, "aborted", "attempt 3 of step 8 is open");
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
  endpoint(0, 5, {{"attempt", 4}});
  refused(0, "aborted", "newer attempt");
  all_done();
  ASSERT_EQ(pushed(), 1U);
  EXPECT_EQ(engine_.pushed[0]["blocks"][0]["way"], "endpoint");
  EXPECT_EQ(engine_.pushed[0]["blocks"][1]["way"], "sockets");
}

TEST_F(Blocks, WhatSeatsBringTogetherIsAsMuchAsBefore) {
  join();
  endpoint(0, 6);
  endpoint(1, 5);
  for (int k = 0; k < 2; ++k) refused(k, "not_conserved", "11 particles brought, scene 's' has 10");
  // When all have begun, before rows have come.
  direct(0, {4, 0, 1}, {{"attempt", 2}, {"inserted", 2}});
  direct(1, {0, 3, 2}, {{"attempt", 2}, {"removed", 1}});
  for (int k = 0; k < 2; ++k) refused(k, "not_conserved", "of which 1 go and 2 come");
  settle();
  EXPECT_EQ(plane_.dropped.size(), 2U);
  endpoint(0, 6, {{"attempt", 3}, {"inserted", 2}});
  endpoint(1, 5, {{"attempt", 3}, {"removed", 1}});
  all_done();
  EXPECT_EQ(engine_.pushed.at(0)["n"], 11);
  EXPECT_EQ(engine_.pushed.at(0)["inserted"], 2);
  EXPECT_EQ(engine_.pushed.at(0)["removed"], 1);
}

TEST_F(Blocks, AtAFirstPushAllHaveWeightsOrNone) {
  for (int k = 0; k < 2; ++k) {
    team_[k] = Client::on_unix(path());
    team_[k].hello("seat", kSessions[k]);
    if (k == 0) team_[k].call("scene.create", {{"scene", "s"}});
    team_[k].call("scene.open", {{"scene", "s"}, {"seat", k}, {"seats", 2}});
  }
  direct(0, {4, 0, 1}, {{"weights", true}});
  direct(1, {0, 3, 2});
  for (int k = 0; k < 2; ++k) refused(k, "invalid_argument", "weights");
  for (int k = 0; k < 2; ++k) endpoint(k, 5, {{"weights", true}, {"attempt", 2}});
  all_done();
  EXPECT_EQ(engine_.pushed.at(0)["weights"], true);
}

TEST_F(Blocks, WhatDoesNotFitTheSceneIsRefusedAlone) {
  join();
  direct(1, {0, 3, 2});
  settle();
  const std::vector<std::uint64_t> mine{4, 0, 1};
  direct(0, mine, {{"ids", false}});
  refused(0, "invalid_argument", "ids");
  direct(0, mine, {{"weights", true}});
  refused(0, "invalid_argument", "weights");
  direct(0, mine, {{"n", 6}});
  refused(0, "invalid_argument", "counts");
  direct(0, {4, 0});
  refused(0, "invalid_argument", "counts");
  direct(0, mine, {{"counts", nullptr}});
  refused(0, "invalid_argument", "counts");
  direct(0, mine, {{"counts", {4.5, 0, 0.5}}});
  refused(0, "invalid_argument", "counts");
  direct(0, mine, {{"incarnation", wire::hex64(1)}});
  refused(0, "not_found", "made anew");
  direct(0, mine, Json::object(), 9);
  refused(0, "invalid_argument", "the others push step 8");
  direct(0, mine, Json::object(), 6);
  refused(0, "stale_step", "step 6");
  settle();
  EXPECT_EQ(plane_.dropped.size(), 9U);  // the other seat's is not among them
  EXPECT_EQ(plane_.opened.size(), 1U);
  EXPECT_EQ(pushed(), 0U);
  direct(0, {4, 0, 2});  // what doesn't fit the others' blocks ends the step for all
  for (int k = 0; k < 2; ++k) refused(k, "not_conserved", "11 particles");
}

TEST_F(Blocks, AShareThatARankLosesEndsTheStepForAll) {
  join();
  direct(0, {4, 0, 1});
  direct(1, {0, 3, 2});
  settle();
  ASSERT_EQ(plane_.opened.size(), 2U);
  const std::uint64_t number =
      plane_.opened[plane_.opened[0].ticket.terms.id.session == kSessions[1] ? 0 : 1].ticket.number;
  whole(1, number, {Code::aborted, "the data connection to rank 1 was lost"});
  for (int k = 0; k < 2; ++k) refused(k, "aborted", "seat 1");
  settle();
  EXPECT_EQ(plane_.dropped.size(), 2U);
  // Then a seat goes in the midst of its slices.
  direct(0, {4, 0, 1}, {{"attempt", 2}});
  direct(1, {0, 3, 2}, {{"attempt", 2}});
  settle();
  team_[1].close();
  refused(0, "aborted", "seat 1");
  team_[0].call("status");
  EXPECT_EQ(plane_.dropped.size(), 4U);
}

TEST_F(Blocks, OneClientPushesStraightToTheRanks) {
  connect(0);
  direct(0, {4, 0, 6}, {{"ids", false}});
  team_[0].call("status");
  ASSERT_EQ(plane_.opened.size(), 1U);
  EXPECT_EQ(plane_.opened[0].counts, (Counts{4, std::nullopt, 6}));
  const std::uint64_t number = plane_.opened[0].ticket.number;
  whole(0, number);
  EXPECT_EQ(pushed(), 0U);
  whole(2, number);
  EXPECT_EQ(team_[0].receive_but_notices().json["report"]["step"], 8);
  const Json& order = engine_.pushed.at(0);
  EXPECT_EQ(order["seats"], 1);
  EXPECT_EQ(order["ids"], false);
  EXPECT_EQ(order["blocks"][0]["number"], number);
  EXPECT_EQ(order["blocks"][0]["seat"], 0);
  direct(0, {0, 0, 0}, {{"removed", 10}}, 9);  // no rank waits for anything
  EXPECT_EQ(team_[0].receive_but_notices().json["report"]["step"], 9);
  EXPECT_EQ(engine_.pushed.at(1)["blocks"], Json::array());
  EXPECT_EQ(plane_.opened.size(), 1U);
}

TEST_F(Blocks, WithoutAListOfRowsMemoryIsOfTheParticlesHeld) {
  engine_.weights = true;
  connect(0);
  std::int64_t step = 8;
  const auto push = [&](const std::vector<const char*>& names, const Json& more) {
    Json begin{{"way", "shared-memory"}, {"memory", memory_of(names)}};
    begin.update(more);
    team_[0].push(step, 10, begin);
    const Received answer = team_[0].receive_but_notices();
    step += answer.type == FrameType::reply ? 1 : 0;
    return answer.code();
  };
  EXPECT_EQ(push({"x", "y"}, Json::object()), "") << "the weights are those that the ranks hold";
  EXPECT_EQ(engine_.pushed.back()["weights"], false);
  EXPECT_FALSE(engine_.pushed.back()["blocks"][0].contains("counts"));
  EXPECT_EQ(push({"x", "y", "w"}, {{"weights", true}}), "");
  EXPECT_EQ(push({"x", "y", "w", "id"}, {{"weights", true}, {"ids", true}}), "unsupported");
  EXPECT_EQ(push({"x", "y", "w", "row"}, {{"weights", true}}), "invalid_argument") << "row without counts";
  EXPECT_EQ(push({"x", "y", "w"}, {{"weights", true}, {"counts", {5, 5, 0}}}), "invalid_argument") << "no row";
  EXPECT_EQ(push({"x", "y", "row"}, {{"counts", {5, 5, 0}}}), "invalid_argument") << "no weights";
  EXPECT_EQ(push({"x", "y", "w", "row"}, {{"weights", true}, {"counts", {5, 5, 0}}}), "");
  EXPECT_EQ(push({"y", "x", "w"}, {{"weights", true}}), "invalid_argument");
  Json odd = memory_of({"x", "y", "w"});
  odd[1]["offset"] = 4;
  EXPECT_EQ(push({}, {{"weights", true}, {"memory", odd}}), "invalid_argument");
  engine_.ids = true;
  EXPECT_EQ(push({"x", "y", "w"}, {{"weights", true}}), "");
  EXPECT_EQ(push({"x", "y", "w"}, {{"weights", true}}), "invalid_argument") << "the scene has ids now";
}

}  // namespace
}  // namespace rcb::net::testing
