// A seat of a scene against a scripted service: what it sends, what it makes of the answer, and how it takes its seat
// again.
#include <array>
#include <optional>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "client/lib/client.hpp"
#include "common/base/random.hpp"
#include "tests/client/lib/fake_service.hpp"
#include "tests/client/lib/told_cuts.hpp"

namespace rcb::client {
namespace {

using protocol::Json;

// What the seat of the tests has.
const std::vector<double> kX{0.5, 1.5, 2.5};
const std::vector<double> kY{10, 11, 12};
const std::vector<std::int64_t> kIds{7, 3, 900};
const std::array<const double*, 2> kAxes{kX.data(), kY.data()};

Json seat_reply(int generation, int step) {
  return {{"scene", "s"},
          {"dims", 2},
          {"step", step < 0 ? Json() : Json(step)},
          {"seat", {{"seat", 1}, {"seats", 3}, {"generation", generation}}}};
}

// Of 6 parts: the three particles are in the parts 0, 1 and 2, and seat 1 has 2 and 3.
ToldCuts told_cuts() { return {2, 6, 0}; }

Json report(int step) {
  return {{"report", {{"scene", "s"}, {"step", step}, {"n", 30}, {"reason", ""}}}, {"cuts", told_cuts().json}};
}

Received receive_push(Peer& peer) {
  auto push = peer.receive();
  EXPECT_TRUE(push);
  return push ? *push : Received{};
}

// The scene's end, and the connection's.
void answer_close(Peer& peer, std::vector<Received>* got = nullptr) {
  const auto close = peer.receive();
  if (!close) return;
  peer.reply(*close, Json::object());
  if (got != nullptr) got->push_back(*close);
  peer.receive();
}

// A client with seat 1 of 3.
struct Seated {
  Result<Client> client;
  Result<Scene> scene;

  explicit Seated(const FakeService& service, bool outlive = true)
      : client(Client::connect({.endpoint = service.endpoint(), .outlive = outlive})),
        scene(client->open_scene("s", {.seat = 1, .seats = 3})) {}
  Result<StepResult> step(const StepOptions& options = {.ids = kIds}) {
    return scene->step(Positions::axes(kAxes, kX.size()), options);
  }
};

TEST(Seat, SendsItsOwnRowsAndIsToldWhatLeaves) {
  std::vector<Received> got;
  FakeService service([&got](Peer& peer, int) {
    peer.greet(2);
    got.push_back(*peer.receive());
    peer.reply(got.back(), seat_reply(4, 6));
    got.push_back(*peer.receive());
    peer.reply(got[1], report(7), told_cuts().arrays);
    answer_close(peer, &got);
  });
  {
    Seated of(service);
    ASSERT_TRUE(of.scene.ok()) << of.scene.status().message();
    EXPECT_EQ(of.client->open_scene("s").status().code(), Code::busy) << "its end would be the seat's";
    EXPECT_EQ(of.client->open_scene("t", {.seat = 3, .seats = 3}).status().code(), Code::invalid_argument);
    EXPECT_EQ(of.scene->last_step(), 6);
    const auto result = of.step({.ids = kIds, .inserted = 2, .removed = 1, .want_parts = true, .want_changes = true});
    ASSERT_TRUE(result.ok()) << result.status().message();
    EXPECT_EQ(result->report.step, 7);
    EXPECT_EQ(of.scene->last_step(), 7);
    ASSERT_EQ(result->leaving.size(), 2U);
    EXPECT_EQ(result->leaving[1].row, 1U);
    EXPECT_EQ(result->leaving[1].to, 0);
    EXPECT_EQ(result->parts, (std::vector<std::int32_t>{0, 1, 2}));
    EXPECT_EQ(result->changes.size(), 3U);
  }
  service.stop();
  ASSERT_EQ(got.size(), 3U);
  EXPECT_EQ(got[0].json["seat"], 1);
  EXPECT_EQ(got[0].json["seats"], 3);
  EXPECT_FALSE(got[0].json.contains("generation"));
  EXPECT_EQ(got[1].json["command"], "push");
  EXPECT_EQ(got[1].json["way"], "endpoint");
  EXPECT_EQ(got[1].json["n"], 3);
  EXPECT_EQ(got[1].json["ids"], true);
  EXPECT_EQ(got[1].json["step"], 7);
  EXPECT_EQ(got[1].json["inserted"], 2);
  EXPECT_EQ(got[1].json["removed"], 1);
  ASSERT_EQ(got[1].arrays.size(), 3U);
  EXPECT_EQ(got[1].values<double>("x"), kX);
  EXPECT_EQ(got[1].values<double>("y"), kY);
  EXPECT_EQ(got[1].values<std::int64_t>("id"), kIds);
  EXPECT_EQ(got[2].json["command"], "scene.close");
}

TEST(Seat, IsToldEachRowThatLeaves) {
  FakeService service([](Peer& peer, int) {
    peer.greet(2);
    peer.reply(*peer.receive(), seat_reply(4, -1));
    const Received begin = receive_push(peer);
    peer.reply(begin, report(0), told_cuts().arrays);
    answer_close(peer);
  });
  constexpr std::size_t kRows = 1000;
  constexpr std::uint64_t kSeed = 77;
  Random random(kSeed);
  std::vector<double> xy;
  std::vector<std::int64_t> ids;
  std::vector<std::pair<std::uint64_t, int>> expected;  // row, and the seat that it goes to
  for (std::size_t row = 0; row < kRows; ++row) {
    const std::uint64_t part = random.below(row < 300 ? 6 : 100) == 0 ? random.below(6) : 2 + random.below(2);
    if (part / 2 != 1) expected.push_back({row, static_cast<int>(part / 2)});
    xy.insert(xy.end(), {static_cast<double>(part) + 0.5, 0});
    ids.push_back(static_cast<std::int64_t>(row));
  }
  Seated of(service);
  ASSERT_TRUE(of.scene.ok()) << of.scene.status().message();
  const auto result = of.scene->step(Positions::rows(xy.data(), kRows, 2), {.ids = ids});
  ASSERT_TRUE(result.ok()) << result.status().message();
  std::vector<std::pair<std::uint64_t, int>> told;
  for (const LeavingRow& one : result->leaving) told.push_back({one.row, one.to});
  EXPECT_EQ(told, expected) << "seed " << kSeed;
}

TEST(Seat, IsTakenAgainWithAHigherGenerationAndTheStepPushedAgain) {
  std::vector<Json> opened, begun;
  FakeService service([&](Peer& peer, int number) {
    peer.greet(2);
    const auto open = peer.receive();
    opened.push_back(open->json);
    peer.reply(*open, seat_reply(number == 0 ? 4 : 5, -1));
    const Received begin = receive_push(peer);
    begun.push_back(begin.json);
    if (number == 0) return;  // the connection goes before the answer
    peer.reply(begin, report(0), told_cuts().arrays);
    answer_close(peer);
  });
  {
    Seated of(service);
    const auto result = of.step();
    EXPECT_TRUE(result.ok()) << result.status().message();
  }
  service.stop();
  ASSERT_EQ(opened.size(), 2U);
  EXPECT_EQ(opened[1]["generation"], 5);
  EXPECT_EQ(begun[0]["step"], begun[1]["step"]);
  EXPECT_LT(begun[0]["attempt"], begun[1]["attempt"]);
}

// Its last holder may be a process whose machine has vanished, in whose place this one was started.
TEST(Seat, ThatIsTakenIsWaitedFor) {
  for (const bool outlive : {true, false}) {
    FakeService service([](Peer& peer, int) {
      peer.greet(2);
      const auto open = peer.receive();
      peer.fail(*open, {Code::busy, "seat 1 of scene 's' is 'jet', generation 3", ""});
      const auto again = peer.receive();
      if (!again || again->json.value("command", "") != "scene.open") return;
      peer.reply(*again, seat_reply(4, -1));
      answer_close(peer);
    });
    const Seated of(service, outlive);
    EXPECT_EQ(of.scene.status().code(), outlive ? Code::ok : Code::busy) << of.scene.status().message();
  }
}

// A connection is lost before the service's answer, which has taken the seat: that generation is used up. One that was
// refused is not, since somebody else has the seat.
TEST(Seat, AsksForNoGenerationTwiceUnlessItWasRefused) {
  std::vector<Json> opened;
  FakeService service([&](Peer& peer, int number) {
    peer.greet(2);
    auto open = peer.receive();
    opened.push_back(open->json);
    if (number == 1) return;
    if (number == 2) {
      peer.fail(*open, {Code::busy, "seat 1 of scene 's' has had generation 7", ""});
      open = peer.receive();
      opened.push_back(open->json);
    }
    peer.reply(*open, seat_reply(number == 0 ? 4 : 6, -1));
    const Received begin = receive_push(peer);
    if (number == 0) return;
    peer.reply(begin, report(0), told_cuts().arrays);
    answer_close(peer);
  });
  {
    Seated of(service);
    EXPECT_EQ(of.step().status().code(), Code::busy);
    const auto result = of.step();
    EXPECT_TRUE(result.ok()) << result.status().message();
  }
  service.stop();
  ASSERT_EQ(opened.size(), 4U);
  EXPECT_EQ(opened[1]["generation"], 5);
  EXPECT_EQ(opened[2]["generation"], 6);
  EXPECT_EQ(opened[3]["generation"], 6);
}

TEST(Seat, FaultsOfTheCallerAndOfTheServiceAreNamed) {
  FakeService service([](Peer& peer, int) {
    peer.greet(2);
    peer.reply(*peer.receive(), seat_reply(1, -1));
    for (int k = 0; k < 3; ++k) {  // an aborted step is tried once more
      const Received begin = receive_push(peer);
      if (k < 2) peer.fail(begin, {Code::aborted, "seat 2 has lost its connection", "push again"});
      if (k == 2) peer.reply(begin, report(0));  // cuts without their arrays
    }
    answer_close(peer);
  });
  Seated of(service, false);
  EXPECT_EQ(of.step({.ids = std::span(kIds).first(2)}).status().code(), Code::invalid_argument);
  EXPECT_EQ(of.step({}).status().code(), Code::invalid_argument) << "a seat's rows need ids";
  EXPECT_EQ(of.scene->step(Positions::rows(kX.data(), 1, 3), {.ids = std::span(kIds).first(1)}).status().code(),
            Code::invalid_argument);
  EXPECT_EQ(of.step({.ids = kIds, .deadline_seconds = 0}).status().code(), Code::invalid_argument);
  const Status aborted = of.step().status();
  EXPECT_EQ(aborted.code(), Code::aborted);
  EXPECT_NE(aborted.message().find("seat 2"), std::string::npos);
  EXPECT_EQ(of.step().status().code(), Code::protocol_error);
}

// Another seat has lost its connection: it comes back, and this one waits for it.
TEST(Seat, AStepThatWasAbortedIsPushedAgain) {
  int pushes = 0;
  FakeService service([&pushes](Peer& peer, int) {
    peer.greet(2);
    peer.reply(*peer.receive(), seat_reply(1, -1));
    for (; pushes < 4; ++pushes) {
      const Received begin = receive_push(peer);
      if (pushes < 3) peer.fail(begin, {Code::aborted, "seat 2 has lost its connection", "push again"});
      if (pushes == 3) peer.reply(begin, report(0), told_cuts().arrays);
    }
    answer_close(peer);
  });
  {
    Seated of(service);
    const auto result = of.step();
    EXPECT_TRUE(result.ok()) << result.status().message();
  }
  service.stop();
  EXPECT_EQ(pushes, 4);
}

// Its answer was lost with the service, which tells the report alone: the rest comes from the cuts.
TEST(Seat, AsksForTheCutsOfAStepThatTheServiceHasCommitted) {
  int pushes = 0;
  FakeService service([&](Peer& peer, int number) {
    peer.greet(2);
    Json seat = seat_reply(4 + number, 6 + number);
    if (number > 0) seat["filled"] = false;
    peer.reply(*peer.receive(), seat);
    const Received begin = receive_push(peer);
    ++pushes;
    if (number == 0) return;
    Json answer = report(7);
    answer.erase("cuts");
    answer["repeated"] = true;
    peer.reply(begin, answer);
    const auto asked = peer.receive();
    EXPECT_EQ(asked->json["command"], "cuts");
    peer.reply(*asked, told_cuts().json, told_cuts().arrays);
    answer_close(peer);
  });
  {
    Seated of(service);
    const auto result = of.step({.ids = kIds, .want_changes = true});
    ASSERT_TRUE(result.ok()) << result.status().message();
    EXPECT_EQ(result->changes.size(), 3U);
    EXPECT_EQ(result->leaving.size(), 2U);
  }
  service.stop();
  EXPECT_EQ(pushes, 2);
}

// The other seats wait for it, and are told what is wrong with its rows.
TEST(Seat, TellsTheOthersWhatItCannotCount) {
  std::vector<Json> asked;
  FakeService service([&asked](Peer& peer, int) {
    peer.greet(2);
    Json seat = seat_reply(1, 6);
    seat.update({{"positions", "when-needed"}, {"ids", true}});
    peer.reply(*peer.receive(), seat);
    while (const auto request = peer.receive()) {
      const auto command = request->json.value("command", "");
      asked.push_back(request->json);
      if (command == "cuts")
        peer.reply(*request, told_cuts().json, told_cuts().arrays);
      else
        peer.fail(*request, {Code::not_finite, "as you say"});
    }
  });
  {
    Seated of(service);
    const std::vector<double> x{0.5, std::numeric_limits<double>::infinity(), 2.5};
    const std::array<const double*, 2> axes{x.data(), kY.data()};
    const Status status = of.scene->step(Positions::axes(axes, 3), {.ids = kIds}).status();
    EXPECT_EQ(status.code(), Code::not_finite);
    EXPECT_EQ(status.message(), "particle 3: x is inf");
  }
  service.stop();
  ASSERT_GE(asked.size(), 2U);
  EXPECT_EQ(asked[1]["command"], "count");
  EXPECT_EQ(asked[1]["fault"]["code"], "not_finite");
}

}  // namespace
}  // namespace rcb::client
