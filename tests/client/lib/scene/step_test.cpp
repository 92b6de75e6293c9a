#include <algorithm>
#include <array>
#include <atomic>
#include <limits>
#include <numeric>
#include <random>

#include <gtest/gtest.h>

#include "client/lib/client.hpp"
#include "common/base/random.hpp"
#include "tests/client/lib/fake_scene.hpp"

namespace rcb::client {
namespace {

// Parts that change for one particle in `rarity` each step.
std::int32_t wandering(std::int64_t id, std::int64_t step, std::uint64_t rarity, std::int32_t parts) {
  const std::uint64_t mixed = mix64(static_cast<std::uint64_t>(id));
  const std::uint64_t moves = (mixed + static_cast<std::uint64_t>(step)) / rarity;
  return static_cast<std::int32_t>((mixed / 7 + moves) % static_cast<std::uint64_t>(parts));
}

// x lies in the region of the particle's part, and all others differ by particle, axis and step.
double coordinate_of(std::int64_t id, std::size_t axis, std::int64_t step, std::int32_t part) {
  if (axis == 0) return part + (static_cast<double>(id % 1000003) + 0.25) / 1000004;
  return static_cast<double>(id) + 0.25 * static_cast<double>(axis) + 1000.5 * static_cast<double>(step);
}

// The caller's arrays for a step, as rows (n, dims) or one array an axis.
struct StepCaller {
  std::size_t n;
  int dims;
  std::vector<std::int64_t> ids;  // empty: rows
  std::vector<double> values;
  std::vector<const double*> axes;
  std::uint64_t rarity = 20;
  std::int32_t parts = 5;

  Positions at(std::int64_t step, bool rows) {
    const auto d = static_cast<std::size_t>(dims);
    values.resize(n * d + 1);
    axes.clear();
    for (std::size_t a = 0; a < d; ++a) {
      axes.push_back(values.data() + a * n);
      for (std::size_t i = 0; i < n; ++i) {
        const std::int64_t id = ids.empty() ? static_cast<std::int64_t>(i) : ids[i];
        values[rows ? i * d + a : a * n + i] = coordinate_of(id, a, step, wandering(id, step, rarity, parts));
      }
    }
    return rows ? Positions::rows(values.data(), n, dims) : Positions::axes(axes, n);
  }
};

struct Session {
  std::unique_ptr<FakeService> service;
  std::optional<Client> client;
  std::optional<Scene> scene;

  explicit Session(FakeScene& fake) {
    service = std::make_unique<FakeService>([&fake](Peer& peer, int) { fake.serve(peer); });
    auto connected = Client::connect({.endpoint = service->endpoint()});
    EXPECT_TRUE(connected.ok()) << connected.status().message();
    client.emplace(std::move(*connected));
    open();
  }
  void open() {
    scene.reset();
    auto opened = client->open_scene("s");
    EXPECT_TRUE(opened.ok()) << opened.status().message();
    scene.emplace(std::move(*opened));
  }
  // What the script wrote may be read after this.
  void end() {
    scene.reset();
    client.reset();
    service->stop();
  }
};

FakeScene scene_of(int dims, int parts, int ranks, std::uint64_t rarity) {
  FakeScene fake(dims, parts, ranks);
  fake.position = [=](std::int64_t id, std::size_t axis, std::int64_t step) {
    return coordinate_of(id, axis, step, wandering(id, step, rarity, parts));
  };
  return fake;
}

StepOptions wanting(std::span<const std::int64_t> ids = {}) {
  StepOptions options;
  options.ids = ids;
  options.want_parts = true;
  options.want_changes = true;
  return options;
}

// Parts and changes of a step against the formula.
void expect_parts(const StepResult& result, const StepCaller& caller, std::int64_t step, std::uint64_t rarity,
                  std::int32_t parts, bool all_rows) {
  ASSERT_EQ(result.parts.size(), caller.n);
  std::vector<PartChange> expected;
  for (std::size_t row = 0; row < caller.n; ++row) {
    const std::int64_t id = caller.ids.empty() ? static_cast<std::int64_t>(row) : caller.ids[row];
    const std::int32_t part = wandering(id, step, rarity, parts);
    ASSERT_EQ(result.parts[row], part) << "row " << row << " step " << step;
    if (all_rows || part != wandering(id, step - 1, rarity, parts)) expected.push_back({row, part});
  }
  ASSERT_EQ(result.changes.size(), expected.size()) << "step " << step;
  for (std::size_t i = 0; i < expected.size(); ++i) {
    EXPECT_EQ(result.changes[i].row, expected[i].row);
    EXPECT_EQ(result.changes[i].part, expected[i].part);
  }
}

// Any rank count, few or many movers, ids of the solver's own in any order, any layout of the arrays: the fake scene
// checks each value, and the parts are right.
TEST(Step, BringsTheRowsAsTheyAre) {
  const std::uint64_t seed = std::random_device{}();
  SCOPED_TRACE("seed " + std::to_string(seed));
  Random random(seed);
  for (const int ranks : {1, 3})
    for (const std::uint64_t rarity : {std::uint64_t{2}, std::uint64_t{100}})
      for (const bool permuted : {false, true}) {
        const int dims = 1 + static_cast<int>(random.below(3));
        const std::int32_t parts = 5;
        StepCaller caller{2 + random.below(3000), dims, {}, {}, {}, rarity, parts};
        if (permuted || random.below(2) == 0)
          for (std::size_t i = 0; i < caller.n; ++i)
            caller.ids.push_back(static_cast<std::int64_t>(7 * i + random.below(7)));
        FakeScene fake = scene_of(dims, parts, ranks, rarity);
        Session session(fake);
        for (std::int64_t step = 0; step < 6; ++step) {
          if (permuted) std::rotate(caller.ids.begin(), caller.ids.begin() + 1, caller.ids.end());
          const auto result = session.scene->step(caller.at(step, random.below(2) == 0), wanting(caller.ids));
          ASSERT_TRUE(result.ok()) << result.status().message();
          EXPECT_EQ(result->report.step, step);
          expect_parts(*result, caller, step, rarity, parts, step == 0 || permuted);
        }
        EXPECT_EQ(session.scene->last_step(), 5);
        session.end();
        EXPECT_EQ(fake.commits, 6);
      }
}

// Who counts knows it; who pushes tells the ranks what it has found out for itself.
TEST(Step, WhatHasDriftedIsToldWhereItIsKnown) {
  FakeScene fake = scene_of(2, 5, 3, 20);
  fake.fault = [&fake](int push) {
    if (push == 3) ++fake.epoch;
    return FakeScene::Fault::none;
  };
  Session session(fake);
  StepCaller caller{500, 2, {}, {}, {}};
  for (std::int64_t step = 0; step < 5; ++step) ASSERT_TRUE(session.scene->step(caller.at(step, true), wanting()).ok());
  for (std::size_t i = 0; i < caller.n; ++i) caller.ids.push_back(static_cast<std::int64_t>(caller.n - 1 - i));
  ASSERT_TRUE(session.scene->step(caller.at(5, true), wanting(caller.ids)).ok());
  session.end();
  const auto drifted = [](std::int64_t step) {
    std::uint64_t count = 0;
    for (std::int64_t id = 0; id < 500; ++id)
      count += wandering(id, step - 1, 20, 5) != wandering(id, step, 20, 5) ? 1U : 0U;
    return count;
  };
  ASSERT_EQ(fake.begun.size(), 6U);
  EXPECT_FALSE(fake.begun[0].contains("drifted"));
  for (const std::int64_t step : {1, 2, 3, 4})
    EXPECT_EQ(fake.begun[static_cast<std::size_t>(step)]["drifted"], drifted(step)) << step;
  EXPECT_FALSE(fake.begun[5].contains("drifted")) << "the rows are in another order";
}

TEST(Step, WhatCameAndWentIsSaid) {
  FakeScene fake = scene_of(2, 5, 3, 20);
  Session session(fake);
  StepCaller caller{500, 2, {}, {}, {}};
  for (std::size_t i = 0; i < caller.n; ++i) caller.ids.push_back(static_cast<std::int64_t>(2 * i));
  ASSERT_TRUE(session.scene->step(caller.at(0, true), wanting(caller.ids)).ok());
  caller.ids.resize(480);
  for (const std::int64_t id : {5001, 5003, 5005}) caller.ids.push_back(id);
  caller.n = caller.ids.size();
  EXPECT_EQ(session.scene->step(caller.at(1, true), wanting(caller.ids)).status().code(), Code::not_conserved);
  StepOptions flow = wanting(caller.ids);
  flow.inserted = 3;
  flow.removed = 20;
  const auto result = session.scene->step(caller.at(1, true), flow);
  ASSERT_TRUE(result.ok()) << result.status().message();
  expect_parts(*result, caller, 1, 20, 5, true);
  session.end();
  EXPECT_EQ(fake.begun[2]["inserted"], 3);
  EXPECT_EQ(fake.begun[2]["removed"], 20);
}

// They go with every push, and with those rows alone.
TEST(Step, WeightsAreKeptForTheirRows) {
  FakeScene fake = scene_of(2, 5, 3, 20);
  Session session(fake);
  StepCaller caller{300, 2, {}, {}, {}};
  for (std::size_t i = 0; i < caller.n; ++i) caller.ids.push_back(static_cast<std::int64_t>(2 * i));
  std::vector<double> weights(caller.n);
  std::iota(weights.begin(), weights.end(), 0.5);
  StepOptions first{.ids = caller.ids, .weights = weights};
  ASSERT_TRUE(session.scene->step(caller.at(0, true), first).ok());
  ASSERT_TRUE(session.scene->step(caller.at(1, true), {.ids = caller.ids}).ok());
  std::swap(caller.ids[3], caller.ids[4]);
  EXPECT_EQ(session.scene->step(caller.at(2, true), {.ids = caller.ids}).status().code(), Code::invalid_argument);
  session.end();
  EXPECT_EQ(fake.weights, weights);
}

TEST(Step, ReportIsRead) {
  FakeScene fake = scene_of(3, 4, 2, 10);
  Session session(fake);
  StepCaller caller{100, 3, {}, {}, {}, 10, 4};
  const auto result = session.scene->step(caller.at(0, true));
  ASSERT_TRUE(result.ok()) << result.status().message();
  const StepReport& report = result->report;
  EXPECT_EQ(report.scene, "s");
  EXPECT_EQ(report.epoch, 1U);
  EXPECT_EQ(report.n, 100U);
  EXPECT_FALSE(report.error_before.has_value());
  EXPECT_EQ(report.error, 0.25);
  EXPECT_EQ(report.imbalance, 1.5);
  EXPECT_TRUE(report.repartitioned);
  EXPECT_EQ(report.reason, "because");
  EXPECT_EQ(report.axes_flipped, 2);
  EXPECT_EQ(report.moved, 3U);
  EXPECT_EQ(report.migrated, 4U);
  EXPECT_EQ(report.skipped, (std::vector<std::string>{"search"}));
  EXPECT_EQ(report.seconds_receive, 0.5);
  EXPECT_EQ(report.seconds_total, 2);
  EXPECT_TRUE(result->parts.empty());
  EXPECT_TRUE(result->changes.empty());
  EXPECT_EQ(protocol::Json::parse(report.json).at("bytes"), 5);
}

TEST(Step, LargeSlicesGoThroughManyWrites) {
  for (const bool rows : {true, false}) {
    FakeScene fake = scene_of(3, 4, 3, 50);
    Session session(fake);
    StepCaller caller{150000, 3, {}, {}, {}, 50, 4};
    for (std::int64_t step = 0; step < 3; ++step) {
      const auto result = session.scene->step(caller.at(step, rows), wanting());
      ASSERT_TRUE(result.ok()) << result.status().message();
      expect_parts(*result, caller, step, 50, 4, step == 0);
    }
  }
}

TEST(Step, NoParticles) {
  FakeScene fake = scene_of(3, 4, 3, 2);
  Session session(fake);
  const auto result = session.scene->step(Positions::rows(static_cast<const double*>(nullptr), 0, 3), wanting());
  ASSERT_TRUE(result.ok()) << result.status().message();
  EXPECT_TRUE(result->parts.empty());
}

// Changes are those since parts or changes were told last, whatever was asked in between.
TEST(Step, ChangesOfStepsThatDidNotAskAreTold) {
  for (const bool first_asked : {true, false}) {
    FakeScene fake = scene_of(3, 5, 3, 5);
    Session session(fake);
    StepCaller caller{1000, 3, {}, {}, {}, 5, 5};
    ASSERT_TRUE(session.scene->step(caller.at(0, true), first_asked ? wanting() : StepOptions()).ok());
    for (std::int64_t step = 1; step < 4; ++step) ASSERT_TRUE(session.scene->step(caller.at(step, true)).ok());
    const auto result = session.scene->step(caller.at(4, true), wanting());
    ASSERT_TRUE(result.ok()) << result.status().message();
    std::vector<std::uint64_t> changed;
    for (std::uint64_t row = 0; row < caller.n; ++row)
      if (const auto id = static_cast<std::int64_t>(row); !first_asked || wandering(id, 0, 5, 5) != result->parts[row])
        changed.push_back(row);
    std::vector<std::uint64_t> told;
    for (const PartChange& change : result->changes) told.push_back(change.row);
    EXPECT_EQ(told, changed) << "first asked: " << first_asked;
    const auto next = session.scene->step(caller.at(5, true), wanting());
    ASSERT_TRUE(next.ok()) << next.status().message();
    expect_parts(*next, caller, 5, 5, 5, false);
  }
}

// A step that failed at its deadline may be committed all the same. Then the same content is answered as that step, and
// other content becomes the next one.
TEST(Step, WhatFollowsAStepThatWasLateIsNotTakenForIt) {
  for (const bool same : {true, false})
    for (const bool lost : {true, false}) {
      FakeScene fake = scene_of(2, 5, 3, 20);
      fake.fault = [=](int push) {
        if (push != 1) return FakeScene::Fault::none;
        return lost ? FakeScene::Fault::close_after_commit : FakeScene::Fault::late_after_commit;
      };
      Session session(fake);
      StepCaller caller{500, 2, {}, {}, {}};
      ASSERT_TRUE(session.scene->step(caller.at(0, true), wanting()).ok());
      StepOptions late = wanting();
      if (lost) {
        fake.close_at = [](const std::string& command, int n) { return command == "scene.open" && n == 1; };
        late.deadline_seconds = 1e-3;
      }
      // With the lost connection it may be answered after all, where the machine is quick enough.
      if (session.scene->step(caller.at(1, true), late).ok()) continue;
      const auto result = session.scene->step(caller.at(same ? 1 : 2, true), wanting());
      ASSERT_TRUE(result.ok()) << result.status().message();  // the fake scene has checked every position
      EXPECT_EQ(result->report.step, same ? 1 : 2);
      const auto next = session.scene->step(caller.at(3, true), {.step = 3, .want_parts = true});
      ASSERT_TRUE(next.ok()) << next.status().message();
      for (std::size_t row = 0; row < caller.n; ++row)
        ASSERT_EQ(next->parts[row], wandering(static_cast<std::int64_t>(row), 3, 20, 5));
    }
}

// A committed step whose parts could not be told has no answer yet: the same once more is answered as that step.
TEST(Step, WhoCannotAskForTheCutsOfAStepHasNoAnswer) {
  FakeScene fake = scene_of(2, 5, 3, 20);
  fake.fault = [&fake](int push) {
    if (push != 1) return FakeScene::Fault::none;
    fake.epoch += 3;  // by others: a repeated answer doesn't bring their cuts
    return FakeScene::Fault::close_after_commit;
  };
  std::atomic<bool> closing{true};  // the service has a thread of its own
  fake.close_at = [&closing](const std::string& command, int) { return command == "cuts" && closing; };
  Session session(fake);
  StepCaller caller{500, 2, {}, {}, {}};
  ASSERT_TRUE(session.scene->step(caller.at(0, true), wanting()).ok());
  StepOptions one{.step = 1, .want_parts = true, .deadline_seconds = 0.5};
  ASSERT_FALSE(session.scene->step(caller.at(1, true), one).ok());
  closing = false;
  one.deadline_seconds = 30;
  const auto result = session.scene->step(caller.at(1, true), one);
  ASSERT_TRUE(result.ok()) << result.status().message();
  EXPECT_EQ(result->report.step, 1);
  for (std::size_t row = 0; row < caller.n; ++row)
    ASSERT_EQ(result->parts[row], wandering(static_cast<std::int64_t>(row), 1, 20, 5));
  EXPECT_EQ(session.scene->cuts()->epoch(), 4U);
  session.end();
  EXPECT_EQ(fake.commits, 2);
}

// Every push says which it knows, and the answer tells those that are new.
TEST(Step, CutsComeWithTheAnswers) {
  FakeScene fake = scene_of(2, 5, 3, 20);
  fake.fault = [&fake](int push) {
    if (push == 2) ++fake.epoch;
    return FakeScene::Fault::none;
  };
  Session session(fake);
  StepCaller caller{500, 2, {}, {}, {}};
  for (std::int64_t step = 0; step < 4; ++step) {
    ASSERT_TRUE(session.scene->step(caller.at(step, true)).ok());
    const auto cuts = session.scene->cuts();
    ASSERT_TRUE(cuts.ok()) << cuts.status().message();
    EXPECT_EQ(cuts->epoch(), step < 2 ? 1U : 2U);
    EXPECT_EQ(cuts->parts(), 5);
  }
  std::vector<std::int32_t> parts(caller.n);
  ASSERT_TRUE(session.scene->cuts()->owner(caller.at(5, true), {}, parts).ok());
  for (std::size_t row = 0; row < caller.n; ++row)
    ASSERT_EQ(parts[row], wandering(static_cast<std::int64_t>(row), 5, 20, 5));
  session.end();
  EXPECT_EQ(std::count(fake.commands.begin(), fake.commands.end(), "cuts"), 0);
  const protocol::Json none = protocol::Json::object();
  const protocol::Json first{{"epoch", 1}, {"hash", ToldCuts(2, 5, 1).json["hash"]}};
  protocol::Json last = first;
  last["epoch"] = 2;
  ASSERT_EQ(fake.begun.size(), 4U);
  const std::vector<protocol::Json> known{none, first, first, last};
  for (std::size_t k = 0; k < known.size(); ++k) EXPECT_EQ(fake.begun[k]["cuts_known"], known[k]);
}

// Among them cuts that aren't those of their hash.
TEST(Step, CutsThatAreDamagedAreRefused) {
  using Spoil = std::function<void(ToldCuts&)>;
  for (const Spoil& spoil :
       {Spoil([](ToldCuts& cuts) { cuts.json["hash"] = "0123456789abcdef"; }),
        Spoil([](ToldCuts& cuts) { cuts.json["parts"] = 6; }), Spoil([](ToldCuts& cuts) { cuts.json["dims"] = 4; }),
        Spoil([](ToldCuts& cuts) { cuts.json["method"] = "spirals"; }),
        Spoil([](ToldCuts& cuts) { cuts.json["epoch"] = "one"; }),
        Spoil([](ToldCuts& cuts) { cuts.arrays.pop_back(); }),
        Spoil([](ToldCuts& cuts) { cuts.arrays[2].dtype = "<u8"; })}) {
    FakeScene fake = scene_of(2, 5, 3, 20);
    fake.spoil_cuts = spoil;
    Session session(fake);
    StepCaller caller{500, 2, {}, {}, {}};
    const Status status = session.scene->step(caller.at(0, true), wanting()).status();
    EXPECT_EQ(status.code(), Code::protocol_error);
    EXPECT_NE(status.message().find("is committed, but its parts are not known"), std::string::npos)
        << status.message();
    EXPECT_EQ(session.scene->cuts().status().code(), Code::protocol_error);
  }
}

TEST(Step, ASceneWithoutPositionsHasNoCuts) {
  FakeScene fake = scene_of(2, 5, 3, 20);
  Session session(fake);
  EXPECT_EQ(session.scene->cuts().status().code(), Code::not_found);
  StepCaller caller{500, 2, {}, {}, {}};
  ASSERT_TRUE(session.scene->step(caller.at(0, true)).ok());
  EXPECT_TRUE(session.scene->cuts().ok());
}

// Then it was not committed, so nothing waits for its answer; and the next one is a number further.
TEST(Step, WhoseNumberAnotherSessionTookGoesOnBehindIt) {
  for (const bool first : {true, false}) {
    FakeScene fake = scene_of(2, 5, 3, 20);
    fake.fault = [first](int push) {
      const int late = first ? 0 : 1;
      return push == late       ? FakeScene::Fault::late
             : push == late + 1 ? FakeScene::Fault::taken
                                : FakeScene::Fault::none;
    };
    Session session(fake);
    StepCaller caller{500, 2, {}, {}, {}};
    const std::int64_t number = first ? 0 : 1;
    if (!first) {
      ASSERT_TRUE(session.scene->step(caller.at(0, true), wanting()).ok());
    }
    ASSERT_FALSE(session.scene->step(caller.at(number, true), wanting()).ok());
    EXPECT_EQ(session.scene->step(caller.at(number, true), wanting()).status().code(), Code::stale_step);
    const auto next = session.scene->step(caller.at(number + 1, true), wanting());
    ASSERT_TRUE(next.ok()) << next.status().message();
    EXPECT_EQ(next->report.step, number + 1);
  }
}

// A service of one rank, whose connections to that rank the test lets go or keeps still.
class OneRank {
 public:
  enum class Does { close, nothing };

  explicit OneRank(Does does) {
    rank_ = std::make_unique<FakeService>([this, does](Peer& peer, int) {
      ++connections;
      if (!peer.greet(1)) return;
      while (const auto frame = peer.receive()) {
        if (frame->json.value("command", "") == "memory.share")
          peer.fail(*frame, {Code::unsupported, "no shared memory here"});
        else if (does == Does::close)
          return;
      }
    });
    control_ = std::make_unique<FakeService>([this, does](Peer& peer, int) {
      peer.send(protocol::FrameType::welcome, 0, Peer::welcome());
      const auto hello = peer.receive();
      if (!hello) return;
      peer.reply(*hello, {{"session", hello->json["session"]}, {"ranks", 1}, {"data", {rank_->endpoint()}}});
      while (const auto frame = peer.receive()) {
        const auto command = frame->json.value("command", "");
        if (command == "scene.open" || command == "scene.show") peer.reply(*frame, scene_);
        if (command == "scene.close") peer.reply(*frame, protocol::Json::object());
        if (command == "push") push(peer, *frame, does);
      }
    });
  }
  const std::string& endpoint() const { return control_->endpoint(); }
  void stop() {
    control_->stop();
    rank_->stop();
  }

  std::vector<std::string> ways;  // of the pushes
  std::atomic<int> connections = 0;

 private:
  void push(Peer& peer, const Received& begin, Does does) {
    ways.push_back(begin.json.value("way", ""));
    if (ways.back() == "endpoint") {
      peer.reply(begin, {{"report", {{"scene", "s"}, {"step", begin.json["step"]}, {"n", 4}, {"reason", ""}}}});
    } else if (does == Does::nothing) {
      peer.fail(begin, {Code::deadline_exceeded, "the push wasn't whole at its deadline"});
    }
  }

  const protocol::Json scene_{{"scene", "s"}, {"dims", 1}, {"parts", 1}, {"n", 0}, {"step", nullptr}};
  std::unique_ptr<FakeService> rank_, control_;
};

// Large enough for the path to the ranks.
std::vector<double> many() { return std::vector<double>(100'000, 0.5); }

TEST(Step, AConnectionToARankThatIsLostIsNoticedWithinTheCall) {
  OneRank service(OneRank::Does::close);
  const auto x = many();
  {
    auto client = Client::connect({.endpoint = service.endpoint()});
    auto scene = client->open_scene("s");
    ASSERT_TRUE(scene.ok()) << scene.status().message();
    EXPECT_TRUE(scene->step(Positions::rows(x.data(), x.size(), 1)).ok());
  }
  service.stop();
  ASSERT_GE(service.ways.size(), 2U);
  EXPECT_NE(service.ways.front(), "endpoint");
  EXPECT_EQ(service.ways.back(), "endpoint");
}

TEST(Step, SilentConnectionsToRanksAreReplacedOnceAndThenLeft) {
  OneRank service(OneRank::Does::nothing);
  const auto x = many();
  {
    auto client = Client::connect({.endpoint = service.endpoint()});
    auto scene = client->open_scene("s");
    ASSERT_TRUE(scene.ok()) << scene.status().message();
    for (int call = 0; call < 3; ++call)
      EXPECT_EQ(scene->step(Positions::rows(x.data(), x.size(), 1)).ok(), call == 2) << call;
  }
  service.stop();
  EXPECT_EQ(service.ways.back(), "endpoint");
  EXPECT_EQ(service.connections, 2);
}

TEST(Step, AFirstPushThatWasLateMustBeHeardOfFirst) {
  FakeScene fake = scene_of(2, 5, 3, 20);
  fake.fault = [](int push) { return push == 0 ? FakeScene::Fault::late_after_commit : FakeScene::Fault::none; };
  Session session(fake);
  StepCaller caller{500, 2, {}, {}, {}};
  for (std::size_t i = 0; i < caller.n; ++i) caller.ids.push_back(static_cast<std::int64_t>(7 * i + 3));
  EXPECT_EQ(session.scene->step(caller.at(0, true), wanting(caller.ids)).status().code(), Code::deadline_exceeded);
  EXPECT_EQ(session.scene->step(caller.at(0, true), wanting()).status().code(), Code::stale_step);
  const auto again = session.scene->step(caller.at(0, true), wanting(caller.ids));
  ASSERT_TRUE(again.ok()) << again.status().message();
  EXPECT_EQ(again->report.step, 0);
  const auto next = session.scene->step(caller.at(1, true), wanting(caller.ids));
  ASSERT_TRUE(next.ok()) << next.status().message();
  expect_parts(*next, caller, 1, 20, 5, false);
}

// It is answered as the call that it is, not as one that doesn't fit a scene of which nothing was told.
TEST(Step, AnotherSizeThanAFirstPushThatWasLateIsToldOfIt) {
  FakeScene fake = scene_of(2, 5, 3, 20);
  std::atomic<bool> cut{true};
  fake.fault = [&cut](int push) {
    if (push == 0) return FakeScene::Fault::close_after_commit;
    return cut ? FakeScene::Fault::close_before_commit : FakeScene::Fault::none;
  };
  Session session(fake);
  StepCaller caller{500, 2, {}, {}, {}}, fewer{400, 2, {}, {}, {}};
  StepOptions late = wanting();
  late.deadline_seconds = 0.2;
  EXPECT_FALSE(session.scene->step(caller.at(0, true), late).ok());
  cut = false;
  const Status status = session.scene->step(fewer.at(0, true), wanting()).status();
  EXPECT_EQ(status.code(), Code::stale_step) << status.message();
  const auto again = session.scene->step(caller.at(0, true), wanting());
  ASSERT_TRUE(again.ok()) << again.status().message();
  EXPECT_EQ(session.scene->step(fewer.at(1, true), wanting()).status().code(), Code::not_conserved);
}

// A scene may be another one by then, at step 0 again: what still comes for the old push must not be taken for its.
TEST(Step, NoPushOfAConnectionBearsAnothersName) {
  FakeScene fake = scene_of(3, 5, 3, 20);
  Session session(fake);
  StepCaller caller{1000, 3, {}, {}, {}};
  ASSERT_TRUE(session.scene->step(caller.at(0, true)).ok());
  session.open();
  ASSERT_TRUE(session.scene->step(caller.at(1, true)).ok());
  session.end();
  EXPECT_EQ(fake.attempts, (std::vector<std::int64_t>{1, 2}));
}

TEST(Step, LostConnectionIsMendedAndTheStepAppliedOnce) {
  for (const auto fault :
       {FakeScene::Fault::close_before_commit, FakeScene::Fault::close_after_commit, FakeScene::Fault::close_in_answer})
    for (const int when : {0, 2}) {
      SCOPED_TRACE("fault " + std::to_string(static_cast<int>(fault)) + " at push " + std::to_string(when));
      FakeScene fake = scene_of(2, 5, 3, 20);
      fake.fault = [=](int push) { return push == when ? fault : FakeScene::Fault::none; };
      Session session(fake);
      StepCaller caller{1000, 2, {}, {}, {}};
      for (std::size_t i = 0; i < caller.n; ++i) caller.ids.push_back(static_cast<std::int64_t>(5000 - 3 * i));
      for (std::int64_t step = 0; step < 5; ++step) {
        const auto result = session.scene->step(caller.at(step, false), wanting(caller.ids));
        ASSERT_TRUE(result.ok()) << result.status().message();
        expect_parts(*result, caller, step, 20, 5, step == 0);
      }
      session.end();
      EXPECT_EQ(fake.commits, 5);
      ASSERT_EQ(fake.sessions.size(), 2U);
      EXPECT_EQ(fake.sessions[0], fake.sessions[1]) << "the same session on the new connection";
    }
}

TEST(Step, ASceneThatWasDroppedMeanwhileIsAClearError) {
  FakeScene fake = scene_of(3, 4, 2, 10);
  std::atomic<bool> gone{false};
  fake.fault = [&](int push) {
    if (push != 1) return FakeScene::Fault::none;
    fake.empty_now = true;
    return FakeScene::Fault::close_before_commit;
  };
  Session session(fake);
  StepCaller caller{100, 3, {}, {}, {}, 10, 4};
  ASSERT_TRUE(session.scene->step(caller.at(0, true)).ok());
  for (int again = 0; again < 2; ++again) {
    const Status status = session.scene->step(caller.at(1, true)).status();
    EXPECT_EQ(status.code(), Code::not_found);
    EXPECT_NE(status.message().find("no scene 's'"), std::string::npos) << status.message();
  }
}

// A rebalance in between is heard of with the next answer, and the parts are by its cuts.
TEST(Step, CutsThatAnotherChangedAreTold) {
  FakeScene fake = scene_of(3, 5, 3, 20);
  fake.fault = [&](int push) {
    if (push == 1) fake.epoch = 7;
    return FakeScene::Fault::none;
  };
  Session session(fake);
  StepCaller caller{1000, 3, {}, {}, {}};
  for (std::int64_t step = 0; step < 3; ++step) {
    const auto result = session.scene->step(caller.at(step, true), wanting());
    ASSERT_TRUE(result.ok());
    expect_parts(*result, caller, step, 20, 5, step == 0);
  }
  EXPECT_EQ(session.scene->cuts()->epoch(), 7U);
}

TEST(Step, AnotherSceneObjectGoesOnWhereTheFirstEnded) {
  FakeScene fake = scene_of(3, 5, 3, 20);
  Session session(fake);
  StepCaller caller{1000, 3, {}, {}, {}};
  for (std::size_t i = 0; i < caller.n; ++i) caller.ids.push_back(static_cast<std::int64_t>(2 * (caller.n - i) + 1));
  ASSERT_TRUE(session.scene->step(caller.at(0, true), wanting(caller.ids)).ok());
  session.open();
  EXPECT_EQ(session.scene->last_step(), 0);
  for (std::int64_t step = 1; step < 3; ++step) {
    const auto result = session.scene->step(caller.at(step, true), wanting(caller.ids));
    ASSERT_TRUE(result.ok()) << result.status().message();
    expect_parts(*result, caller, step, 20, 5, step == 1);
  }
}

// The service answers before the rows have come, and reads on: the client must neither hang nor lose its place in the
// stream.
TEST(Step, EarlyRefusalOfALargePush) {
  int connections = 0;
  FakeService service([&connections](Peer& peer, int) {
    ++connections;
    if (!peer.greet(1)) return;
    peer.reply(*peer.receive(), {{"dims", 3}, {"parts", 1}, {"step", nullptr}});
    const auto [refused, bytes] = peer.receive_head();
    peer.fail(refused, {Code::busy, "held by another"});
    std::vector<char> rows(bytes);
    peer.read(rows.data(), rows.size());
    const auto push = peer.receive();
    if (!push) return;
    peer.reply(*push, {{"report", {{"scene", "s"}, {"step", 0}, {"n", 500000}, {"reason", ""}}}});
    peer.receive();
  });
  {
    auto client = Client::connect({.endpoint = service.endpoint()});
    auto scene = client->open_scene("s");
    ASSERT_TRUE(scene.ok());
    StepCaller caller{500000, 3, {}, {}, {}};
    const Status status = scene->step(caller.at(0, true)).status();
    EXPECT_EQ(status.code(), Code::busy);
    EXPECT_EQ(status.message(), "held by another");
    EXPECT_TRUE(scene->step(caller.at(0, true)).ok());
  }
  service.stop();
  EXPECT_EQ(connections, 1) << "on the same connection";
}

// A service that refuses and closes without reading the rows: the reason still reaches the caller.
TEST(Step, RefusalAndCloseWhileTheClientSends) {
  for (const bool tcp : {false, true}) {
    FakeService service(
        [tcp](Peer& peer, int) {
          if (!peer.greet(1, "0000000000000001", tcp ? "secret" : "")) return;
          auto open = peer.receive();
          if (!open) return;
          peer.reply(*open, {{"dims", 3}, {"parts", 1}});
          peer.fail(peer.receive_head().first, {Code::too_large, "too much", "send less"});
          std::vector<char> some(1U << 20U);  // so that the client is in the middle of its rows
          peer.read(some.data(), some.size());
          ::usleep(20000);
        },
        tcp);
    auto client = Client::connect({.endpoint = service.endpoint(), .token = "secret"});
    ASSERT_TRUE(client.ok());
    auto scene = client->open_scene("s");
    ASSERT_TRUE(scene.ok());
    StepCaller caller{1000000, 3, {}, {}, {}};
    const Status status = scene->step(caller.at(0, true)).status();
    EXPECT_EQ(status.code(), Code::too_large) << status.message();
  }
}

TEST(Step, AServiceThatStopsReadingMeetsTheDeadline) {
  FakeService service([](Peer& peer, int) {
    if (!peer.greet(1)) return;
    auto open = peer.receive();
    if (!open) return;
    peer.reply(*open, {{"dims", 3}, {"parts", 1}});
    peer.receive_head();
    ::sleep(4);
  });
  auto client = Client::connect({.endpoint = service.endpoint()});
  ASSERT_TRUE(client.ok());
  auto scene = client->open_scene("s");
  ASSERT_TRUE(scene.ok());
  StepCaller caller{1000000, 3, {}, {}, {}};
  StepOptions options;
  options.deadline_seconds = 0.1;
  EXPECT_EQ(scene->step(caller.at(0, true), options).status().code(), Code::deadline_exceeded);
}

TEST(Step, WhatCannotFitIsRefusedBeforeItIsSent) {
  FakeScene fake = scene_of(3, 4, 2, 10);
  Session session(fake);
  StepCaller caller{100, 3, {}, {}, {}, 10, 4};
  const auto refused = [&](const Positions& positions, const StepOptions& options, const std::string& words) {
    const Status status = session.scene->step(positions, options).status();
    EXPECT_EQ(status.code(), Code::invalid_argument);
    EXPECT_NE(status.message().find(words), std::string::npos) << status.message();
    EXPECT_FALSE(status.hint().empty());
  };
  const Positions good = caller.at(0, true);
  Positions bad = good;
  bad.dims = 2;
  refused(bad, {}, "2 dimensions, the scene has 3");
  bad = good;
  bad.axis[1] = nullptr;
  refused(bad, {}, "axis y");
  bad = good;
  bad.stride = 0;
  refused(bad, {}, "stride");
  const std::vector<std::int64_t> ids(99);
  refused(good, {.ids = ids}, "99 ids for 100");
  const std::vector<double> weights(101);
  refused(good, {.weights = weights}, "101 weights for 100");
  refused(good, {.step = -1}, "step -1");
  refused(good, {.deadline_seconds = 0}, "deadline");
  refused(good, {.deadline_seconds = std::numeric_limits<double>::quiet_NaN()}, "deadline");
  refused(good, {.step_seconds = -1}, "-1 seconds");
  refused(good, {.threads = 0}, "0 threads");
  ASSERT_TRUE(session.scene->step(good).ok());
  session.end();
  EXPECT_EQ(fake.attempts.size(), 1U);
}

}  // namespace
}  // namespace rcb::client
