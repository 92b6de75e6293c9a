// MemberScene against a scripted service: what it sends, what it makes of the answer, and how it takes its seat again.
#include "client/lib/member.hpp"

#include <array>
#include <optional>
#include <vector>

#include <gtest/gtest.h>

#include "tests/client/lib/fake_service.hpp"
#include "tests/client/lib/three_particles.hpp"
#include "tests/client/lib/told_cuts.hpp"

namespace rcb::client {
namespace {

using protocol::array_of;
using protocol::Json;

Json seat_reply(int generation, int step) {
  return {{"scene", "s"},
          {"dims", 2},
          {"step", step < 0 ? Json() : Json(step)},
          {"membership", {{"member", 1}, {"members", 3}, {"generation", generation}, {"follow", true}}}};
}

// Of 6 parts: the three particles are in the parts 0, 1 and 2, and member 1 has 2 and 3.
ToldCuts told_cuts() { return {2, 6, 0}; }

Json report(int step) {
  return {{"report", {{"scene", "s"}, {"step", step}, {"n", 30}, {"reason", ""}}}, {"cuts", told_cuts().json}};
}

std::vector<protocol::Array> news() {
  std::vector<protocol::Array> arrays = told_cuts().arrays;
  arrays.insert(arrays.end(),
                {array_of<std::int64_t>("changed_id", "<i8", {3}), array_of<std::int32_t>("changed_part", "<i4", {4})});
  return arrays;
}

// The scene's end, and the connection's.
void answer_close(Peer& peer, std::vector<Received>* got = nullptr) {
  const auto close = peer.receive();
  if (!close) return;
  peer.reply(*close, Json::object());
  if (got != nullptr) got->push_back(*close);
  peer.receive();
}

// A client with the seat of member 1 of 3.
struct Seated {
  Result<Client> client;
  Result<MemberScene> scene;

  explicit Seated(const FakeService& service)
      : client(Client::connect({.endpoint = service.endpoint()})),
        scene(MemberScene::open(*client, "s", {.member = 1, .members = 3, .follow = true})) {}
};

MemberStepOptions with_changes() {
  MemberStepOptions options;
  options.want_changes = true;
  return options;
}

TEST(MemberScene, SendsItsOwnParticlesWithTheirIdsAndReadsWhatMoves) {
  std::vector<Received> got;
  FakeService service([&got](Peer& peer, int) {
    peer.greet(2);
    got.push_back(*peer.receive());
    peer.reply(got.back(), seat_reply(4, 6));
    got.push_back(*peer.receive());
    got.push_back(*peer.receive());
    peer.reply(got[1], report(7), news());
    answer_close(peer, &got);
  });
  {
    auto client = Client::connect({.endpoint = service.endpoint()});
    ASSERT_TRUE(client.ok()) << client.status().message();
    auto scene = MemberScene::open(*client, "s", {.member = 1, .members = 3, .follow = true});
    ASSERT_TRUE(scene.ok()) << scene.status().message();
    EXPECT_EQ(client->open_scene("s").status().code(), Code::busy) << "its end would be the member's";
    EXPECT_EQ(scene->generation(), 4U);
    EXPECT_EQ(scene->last_step(), 6);
    const auto result = scene->step(Positions::axes(kAxes, 3), kIds, with_changes());
    ASSERT_TRUE(result.ok()) << result.status().message();
    EXPECT_EQ(result->report.step, 7);
    EXPECT_EQ(scene->last_step(), 7);
    ASSERT_EQ(result->leaving.size(), 2U);
    EXPECT_EQ(result->leaving[1].row, 1U);
    EXPECT_EQ(result->leaving[1].to, 0);
    ASSERT_EQ(result->changes.size(), 1U);
    EXPECT_EQ(result->changes[0].part, 4);
  }
  service.stop();
  ASSERT_EQ(got.size(), 4U);
  EXPECT_EQ(got[0].json["member"], 1);
  EXPECT_EQ(got[0].json["members"], 3);
  EXPECT_FALSE(got[0].json.contains("generation"));
  EXPECT_EQ(got[1].json["command"], "push.begin");
  EXPECT_EQ(got[1].json["n"], 3);
  EXPECT_EQ(got[1].json["slices"], 1);
  EXPECT_EQ(got[1].json["order"], "id");
  EXPECT_EQ(got[1].json["ids"], true);
  EXPECT_EQ(got[1].json["step"], 7);
  ASSERT_EQ(got[2].arrays.size(), 3U);
  EXPECT_EQ(got[2].values<double>("x"), kX);
  EXPECT_EQ(got[2].values<double>("y"), kY);
  EXPECT_EQ(got[2].values<std::int64_t>("id"), kIds);
  EXPECT_EQ(got[3].json["command"], "scene.close");
}

TEST(MemberScene, ReturnsWithAHigherGenerationAndPushesAgain) {
  std::vector<Json> opened, begun;
  FakeService service([&](Peer& peer, int number) {
    peer.greet(2);
    const auto open = peer.receive();
    opened.push_back(open->json);
    peer.reply(*open, seat_reply(number == 0 ? 4 : 5, -1));
    const auto begin = peer.receive();
    begun.push_back(begin->json);
    peer.receive();
    if (number == 0) return;  // the connection goes before the answer
    peer.reply(*begin, report(0), news());
    answer_close(peer);
  });
  {
    auto [client, scene] = Seated(service);
    const auto result = scene->step(Positions::axes(kAxes, 3), kIds, with_changes());
    EXPECT_TRUE(result.ok()) << result.status().message();
    EXPECT_EQ(scene->generation(), 5U);
  }
  service.stop();
  ASSERT_EQ(opened.size(), 2U);
  EXPECT_EQ(opened[1]["generation"], 5);
  EXPECT_EQ(begun[0]["session"], begun[1]["session"]);
  EXPECT_EQ(begun[0]["step"], begun[1]["step"]);
  EXPECT_LT(begun[0]["attempt"], begun[1]["attempt"]);
}

// Its last holder may be a process whose machine has vanished, in whose place this one was started.
TEST(MemberScene, WaitsForASeatThatIsTaken) {
  for (const bool outlive : {true, false}) {
    FakeService service([](Peer& peer, int) {
      peer.greet(2);
      const auto open = peer.receive();
      peer.fail(*open, {Code::busy, "member 1 of scene 's' is 'jet', generation 3", ""});
      const auto again = peer.receive();
      if (!again || again->json.value("command", "") != "scene.open") return;
      peer.reply(*again, seat_reply(4, -1));
      answer_close(peer);
    });
    auto client = Client::connect({.endpoint = service.endpoint(), .outlive = outlive});
    ASSERT_TRUE(client.ok()) << client.status().message();
    const auto scene = MemberScene::open(*client, "s", {.member = 1, .members = 3, .follow = true});
    EXPECT_EQ(scene.status().code(), outlive ? Code::ok : Code::busy) << scene.status().message();
  }
}

// A connection is lost before the service's answer, which has taken the seat: that generation is used up. One that was
// refused is not, since somebody else has the seat.
TEST(MemberScene, AsksForNoGenerationTwiceUnlessItWasRefused) {
  std::vector<Json> opened;
  FakeService service([&](Peer& peer, int number) {
    peer.greet(2);
    auto open = peer.receive();
    opened.push_back(open->json);
    if (number == 1) return;
    if (number == 2) {
      peer.fail(*open, {Code::busy, "member 1 of scene 's' has had generation 7", ""});
      open = peer.receive();
      opened.push_back(open->json);
    }
    peer.reply(*open, seat_reply(number == 0 ? 4 : 6, -1));
    const auto begin = peer.receive();
    peer.receive();
    if (number == 0) return;
    peer.reply(*begin, report(0), news());
    answer_close(peer);
  });
  {
    auto [client, scene] = Seated(service);
    EXPECT_EQ(scene->step(Positions::axes(kAxes, 3), kIds).status().code(), Code::busy);
    const auto result = scene->step(Positions::axes(kAxes, 3), kIds);
    EXPECT_TRUE(result.ok()) << result.status().message();
    EXPECT_EQ(scene->generation(), 6U);
  }
  service.stop();
  ASSERT_EQ(opened.size(), 4U);
  EXPECT_EQ(opened[1]["generation"], 5);
  EXPECT_EQ(opened[2]["generation"], 6);
  EXPECT_EQ(opened[3]["generation"], 6);
}

// A change of a particle that nobody names is told to the member of its part, which may not be the one that has it.
TEST(MemberScene, BringsAllItsParticlesWhereItAsksForChanges) {
  std::vector<Json> begun;
  FakeService service([&](Peer& peer, int) {
    peer.greet(2);
    peer.reply(*peer.receive(), seat_reply(4, 6));
    for (int step = 7; step < 11; ++step) {
      const auto begin = peer.receive();
      begun.push_back(begin->json);
      if (begin->json["slices"] == 1) peer.receive();
      peer.reply(*begin, report(step), news());
    }
    answer_close(peer);
  });
  {
    auto [client, scene] = Seated(service);
    MemberStepOptions unmoved;
    unmoved.unmoved = true;
    for (const bool changes : {false, false, true, false}) {
      unmoved.want_changes = changes;
      EXPECT_TRUE(scene->step(Positions::axes(kAxes, 3), kIds, unmoved).ok());
    }
  }
  service.stop();
  ASSERT_EQ(begun.size(), 4U);
  EXPECT_EQ(begun[0]["moved"], "all") << "an object that has heard of no step knows nothing";
  EXPECT_EQ(begun[1]["moved"], "none");
  EXPECT_EQ(begun[2]["moved"], "all");
  EXPECT_EQ(begun[3]["moved"], "none");
}

// Also where the answer has no arrays, being that of a step that was committed before.
TEST(MemberScene, WhatLeavesIsFoundByTheCutsAlsoAmongWhatItInserts) {
  FakeService service([&](Peer& peer, int) {
    peer.greet(2);
    peer.reply(*peer.receive(), seat_reply(4, 6));
    for (const bool repeated : {false, true}) {
      const auto begin = peer.receive();
      for (int k = 0; k < begin->json["slices"]; ++k) peer.receive();
      Json answer = report(repeated ? 8 : 7);
      std::vector<protocol::Array> arrays;
      if (repeated) answer["repeated"] = true, answer.erase("cuts");
      if (!repeated) arrays = news(), arrays.push_back(array_of<std::int64_t>("inserted_id", "<i8", {901, 902, 903}));
      peer.reply(*begin, answer, arrays);
    }
    answer_close(peer);
  });
  {
    auto [client, scene] = Seated(service);
    const std::vector<double> x{2.5, 4.5, 0.5}, y{0, 0, 0};  // the parts 2, 4 and 0
    const std::array<const double*, 2> axes{x.data(), y.data()};
    Insertion in{.positions = Positions::axes(axes, 3)};
    const std::vector<std::int64_t> removed{3}, ids{901, 902, 903};
    for (const bool repeated : {false, true}) {
      MemberStepOptions options;
      options.removed = removed;
      options.inserted = &in;
      options.want_parts = true;
      if (repeated) in.ids = ids;
      const auto result = scene->step(Positions::axes(kAxes, 3), kIds, options);
      ASSERT_TRUE(result.ok()) << result.status().message();
      EXPECT_EQ(result->inserted_ids, ids);
      EXPECT_EQ(result->parts, (std::vector<std::int32_t>{0, 1, 2, 2, 4, 0}));
      std::vector<std::pair<std::uint64_t, int>> leaving;
      for (const LeavingRow& one : result->leaving) leaving.emplace_back(one.row, one.to);
      EXPECT_EQ(leaving, (std::vector<std::pair<std::uint64_t, int>>{{0, 0}, {4, 2}, {5, 0}}));
    }
  }
  service.stop();
}

TEST(MemberScene, OfAReplacedSceneItsArraysHaveTheNewDimensions) {
  FakeService service([](Peer& peer, int) {
    peer.greet(2);
    peer.reply(*peer.receive(), seat_reply(1, 6));
    peer.reply(*peer.receive(), {{"scene", "s"}, {"dims", 3}});
    answer_close(peer);
  });
  {
    auto [client, scene] = Seated(service);
    EXPECT_EQ(scene->position_rows(10)->size(), 20U);
    EXPECT_EQ(scene->last_step(), 6);
    EXPECT_TRUE(client->create_scene("s", {.parts = 4, .dims = 3, .replace = true}).ok());
    EXPECT_EQ(scene->position_rows(10)->size(), 30U);
    EXPECT_EQ(scene->position_axes(10)->size(), 3U);
    EXPECT_FALSE(scene->last_step());
  }
  service.stop();
}

// A rebalance that came while the connection was gone told nobody who has which particle now.
TEST(MemberScene, AfterNewCutsThatItWasNotToldOfItBringsAllItsParticles) {
  for (const int epoch_now : {3, 4}) {
    std::vector<Json> begun;
    FakeService service([&](Peer& peer, int number) {
      peer.greet(2);
      Json seat = seat_reply(4 + number, number == 0 ? -1 : 0);
      seat["epoch"] = number == 0 ? 0 : epoch_now;
      peer.reply(*peer.receive(), seat);
      for (int step = number; step < 2; ++step) {
        const auto begin = peer.receive();
        begun.push_back(begin->json);
        if (begin->json["slices"] == 1) peer.receive();
        Json answer = report(step);
        answer["report"]["epoch"] = 3;
        if (step == 0) {
          peer.reply(*begin, answer, news());
          return;
        }
        peer.reply(*begin, answer, news());
      }
      answer_close(peer);
    });
    {
      auto [client, scene] = Seated(service);
      ASSERT_TRUE(scene->step(Positions::axes(kAxes, 3), kIds).ok());
      MemberStepOptions unmoved;
      unmoved.unmoved = true;
      const std::vector<std::int64_t> told{5, 900};
      const auto result = scene->step(Positions::axes(kAxes, 2), told, unmoved);
      EXPECT_TRUE(result.ok()) << result.status().message();
    }
    service.stop();
    ASSERT_EQ(begun.size(), 2U);
    EXPECT_EQ(begun[1]["moved"], epoch_now == 3 ? "none" : "all");
  }
}

TEST(MemberScene, FaultsOfTheCallerAndOfTheServiceAreNamed) {
  FakeService service([](Peer& peer, int) {
    peer.greet(2);
    peer.reply(*peer.receive(), seat_reply(1, -1));
    for (int k = 0; k < 2; ++k) {
      const auto begin = peer.receive();
      peer.receive();
      if (k == 0) peer.fail(*begin, {Code::aborted, "member 2 has lost its connection", "push again"});
      if (k == 1) peer.reply(*begin, report(0), told_cuts().arrays);  // without what changed
    }
    answer_close(peer);
  });
  auto client = Client::connect({.endpoint = service.endpoint(), .outlive = false});
  auto scene = MemberScene::open(*client, "s", {.member = 1, .members = 3, .follow = true});
  const Positions mine = Positions::axes(kAxes, 3);
  EXPECT_EQ(scene->step(mine, std::span(kIds).first(2)).status().code(), Code::invalid_argument);
  EXPECT_EQ(scene->step(Positions::rows(kX.data(), 1, 3), {}).status().code(), Code::invalid_argument);
  MemberStepOptions late;
  late.deadline_seconds = 0;
  EXPECT_EQ(scene->step(mine, kIds, late).status().code(), Code::invalid_argument);
  const Status aborted = scene->step(mine, kIds).status();
  EXPECT_EQ(aborted.code(), Code::aborted);
  EXPECT_NE(aborted.message().find("member 2"), std::string::npos);
  EXPECT_EQ(scene->step(mine, kIds, with_changes()).status().code(), Code::protocol_error);
}

// Another member has lost its connection: it comes back, and this one waits for it.
TEST(MemberScene, AStepThatWasAbortedIsPushedAgain) {
  int pushes = 0;
  FakeService service([&pushes](Peer& peer, int) {
    peer.greet(2);
    peer.reply(*peer.receive(), seat_reply(1, -1));
    for (; pushes < 4; ++pushes) {
      const auto begin = peer.receive();
      if (!begin || !peer.receive()) return;
      if (pushes < 3) peer.fail(*begin, {Code::aborted, "member 2 has lost its connection", "push again"});
      if (pushes == 3) peer.reply(*begin, report(0), news());
    }
    answer_close(peer);
  });
  {
    auto [client, scene] = Seated(service);
    const auto result = scene->step(Positions::axes(kAxes, 3), kIds);
    EXPECT_TRUE(result.ok()) << result.status().message();
  }
  service.stop();
  EXPECT_EQ(pushes, 4);
}

Json seat_unfilled(int generation, int step, bool weights) {
  Json seat = seat_reply(generation, step);
  seat.update({{"filled", false}, {"weights", weights}});
  return seat;
}

// The service was started again, and its ranks hold no particles.
TEST(MemberScene, BringsItsParticlesToAServiceThatWasStartedAgain) {
  std::vector<Received> begun;
  FakeService service([&](Peer& peer, int number) {
    peer.greet(2);
    const auto open = peer.receive();
    peer.reply(*open, number == 0 ? seat_reply(4, 6) : seat_unfilled(5, 6, false));
    for (int k = number == 0 ? 1 : 0; k < 2; ++k) {
      begun.push_back(*peer.receive());
      peer.receive();
      if (number == 0) return;
      if (k == 0)
        peer.reply(begun.back(), {{"refilled", true}});
      else
        peer.reply(begun.back(), report(7), news());
    }
    answer_close(peer);
  });
  {
    auto [client, scene] = Seated(service);
    const auto result = scene->step(Positions::axes(kAxes, 3), kIds);
    EXPECT_TRUE(result.ok()) << result.status().message();
    EXPECT_EQ(scene->last_step(), 7);
  }
  service.stop();
  ASSERT_EQ(begun.size(), 3U);
  EXPECT_EQ(begun[1].json["step"], 6);
  EXPECT_EQ(begun[1].json["refill"], true);
  EXPECT_EQ(begun[1].json["n"], 3);
  EXPECT_EQ(begun[2].json["step"], 7);
  EXPECT_FALSE(begun[2].json.contains("refill"));
  for (const Received& begin : begun) {
    EXPECT_EQ(begin.json["moved"], "all");
    EXPECT_EQ(begin.json["order"], "id");
  }
}

// Its answer was lost with the service, which tells the report alone: the rest comes from the cuts.
TEST(MemberScene, AsksForTheAnswerToAStepThatTheServiceHasCommitted) {
  std::vector<Json> begun;
  FakeService service([&](Peer& peer, int number) {
    peer.greet(2);
    peer.reply(*peer.receive(), number == 0 ? seat_reply(4, 6) : seat_unfilled(5, 7, false));
    const auto begin = peer.receive();
    begun.push_back(begin->json);
    if (number == 0) return static_cast<void>(peer.receive());
    Json answer = report(7);
    answer.erase("cuts");
    answer.update({{"repeated", true}, {"first_id", 77}});
    peer.reply(*begin, answer);
    const auto asked = peer.receive();
    EXPECT_EQ(asked->json["command"], "cuts");
    peer.reply(*asked, told_cuts().json, told_cuts().arrays);
    answer_close(peer);
  });
  {
    auto [client, scene] = Seated(service);
    MemberStepOptions options = with_changes();
    const std::array<double, 2> more{1.5, 2.5};
    const Insertion in{.positions = Positions::rows(more.data(), 1, 2)};
    options.inserted = &in;
    const auto result = scene->step(Positions::axes(kAxes, 3), kIds, options);
    ASSERT_TRUE(result.ok()) << result.status().message();
    EXPECT_EQ(result->changes.size(), 3U);
    EXPECT_EQ(result->inserted_ids, (std::vector<std::int64_t>{77}));
    EXPECT_FALSE(result->leaving.empty());
  }
  service.stop();
  ASSERT_EQ(begun.size(), 2U);
  EXPECT_EQ(begun[1]["moved"], "none");
  EXPECT_EQ(begun[1]["slices"], 0);
  EXPECT_EQ(begun[1]["session"], begun[0]["session"]);
}

// Weights are the solver's to bring: every member says so by the same rule, so that none waits for another.
TEST(MemberScene, WeightsThatTheRanksLackAreAskedFor) {
  std::vector<Json> begun;
  FakeService service([&](Peer& peer, int) {
    peer.greet(2);
    peer.reply(*peer.receive(), seat_unfilled(4, 6, true));
    for (int k = 0; k < 2; ++k) {
      const auto begin = peer.receive();
      begun.push_back(begin->json);
      peer.receive();
      if (k == 0)
        peer.reply(*begin, {{"refilled", true}});
      else
        peer.reply(*begin, report(7), news());
    }
    answer_close(peer);
  });
  {
    auto [client, scene] = Seated(service);
    const Status status = scene->step(Positions::axes(kAxes, 3), kIds).status();
    EXPECT_EQ(status.code(), Code::base_lost) << status.message();
    EXPECT_NE(status.message().find("which has weights"), std::string::npos) << status.message();
    const std::vector<double> weights{1, 2, 3};
    MemberStepOptions with;
    with.weights = weights;
    const auto result = scene->step(Positions::axes(kAxes, 3), kIds, with);
    EXPECT_TRUE(result.ok()) << result.status().message();
  }
  service.stop();
  ASSERT_EQ(begun.size(), 2U);
  for (const Json& begin : begun) EXPECT_EQ(begin["weights"], true);
}

}  // namespace
}  // namespace rcb::client
