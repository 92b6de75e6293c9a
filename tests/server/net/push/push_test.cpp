// Pushes: whole or not at all, one at a time, and whatever a client does in the middle changes nothing.
#include "server/net/push/push.hpp"

#include <array>
#include <cstring>

#include <gtest/gtest.h>

#include "tests/server/net/harness.hpp"

namespace rcb::net::testing {
namespace {

using wire::FrameType;
using wire::Json;

const std::vector<std::string> kCreated{"scene.create"};

// What Client::push() sends for four particles.
Json push_of_four() {
  return {{"command", "push"},
          {"scene", "s"},
          {"step", 0},
          {"attempt", 1},
          {"n", 4},
          {"arrays",
           {{{"name", "x"}, {"dtype", "<f8"}, {"shape", {4}}}, {{"name", "y"}, {"dtype", "<f8"}, {"shape", {4}}}}}};
}

TEST(Widen, AnyCountWhereFloatsAreTheLastHalfOfDoubles) {
  for (std::size_t count = 0; count < 40; ++count) {
    std::vector<double> doubles(count);
    const std::span<std::byte> room = std::as_writable_bytes(std::span(doubles));
    const std::span<std::byte> floats = room.subspan(room.size() / 2);
    for (std::size_t i = 0; i < count; ++i) {
      const float value = 0.1F * static_cast<float>(i) - 1;
      std::memcpy(floats.data() + i * sizeof value, &value, sizeof value);
    }
    widen(floats, room);
    for (std::size_t i = 0; i < count; ++i)
      EXPECT_EQ(doubles[i], static_cast<double>(0.1F * static_cast<float>(i) - 1)) << i << " of " << count;
  }
}

class Push : public ::testing::Test {
 protected:
  Push() { anna_.call("scene.create", {{"scene", "s"}, {"dims", 2}}); }
  static void commit(Client& client, std::int64_t step, std::uint64_t n, const Json& more = Json::object()) {
    client.push(step, n, more);
    EXPECT_EQ(client.receive_but_notices().json["report"]["step"], step);
  }
  // Anna's push of step 0, but for the rows, has come to the service.
  void begin(std::uint64_t n, const Json& more = Json::object()) {
    anna_.begin(0, n, more);
    while (bert_.call("count", {{"scene", "s"}, {"step", 0}}).code() != "busy") {
    }
  }
  TestService service_;
  Client anna_ = service_.client("anna", kAnna);
  Client bert_ = service_.client("bert", kBert);
};

TEST_F(Push, RowsReachTheEngineAsTheyWereSent) {
  const std::string sent = anna_.push(3, 5, {{"step_seconds", 0.5}, {"drifted", 2}}, true);
  const Received report = anna_.receive();
  EXPECT_EQ(report.type, FrameType::reply);
  EXPECT_EQ(report.request, 3U);  // hello, create, push
  EXPECT_EQ(report.json["report"]["step"], 3);
  const auto slices = service_.engine().slices();
  ASSERT_EQ(slices.size(), 1U);
  EXPECT_EQ(slices[0].count, 5U);
  std::string got;
  for (const wire::Array& array : slices[0].arrays)
    got.append(reinterpret_cast<const char*>(array.bytes.data()), array.bytes.size());
  EXPECT_EQ(got, sent);
  EXPECT_EQ(slices[0].arrays[1].name, "y");
  const Json order = service_.engine().request();
  EXPECT_EQ(order["step_seconds"], 0.5);
  EXPECT_EQ(order["drifted"], 2);
  EXPECT_EQ(anna_.call("status").json["scenes"][0]["step"], 3);
}

TEST_F(Push, NoParticlesNeedNoArrays) {
  anna_.push(0, 0, {{"weights", true}});
  EXPECT_EQ(anna_.receive().json["report"]["step"], 0);
  EXPECT_EQ(service_.engine().request()["blocks"], Json::array());
  EXPECT_EQ(service_.engine().request()["weights"], true);
}

TEST_F(Push, ALargeOneArrivesWhole) {
  constexpr std::uint64_t kCount = 2000000;  // 32 MB
  const std::string sent = anna_.push(0, kCount, Json::object(), true);
  EXPECT_EQ(anna_.receive_but_notices().json["report"]["step"], 0);
  const auto slices = service_.engine().slices();
  ASSERT_EQ(slices.size(), 1U);
  EXPECT_EQ(std::memcmp(slices[0].arrays[1].bytes.data(), sent.data() + kCount * 8, kCount * 8), 0);
}

TEST_F(Push, AClientThatVanishesLeavesNothing) {
  begin(4);
  bert_.push(0, 4);
  EXPECT_EQ(bert_.receive().code(), "busy");
  anna_.close();
  std::string code = "busy";
  while (code == "busy") {
    bert_.push(0, 4);
    code = bert_.receive().code();
  }
  EXPECT_EQ(code, "");
  EXPECT_EQ(service_.engine().executed(), (std::vector<std::string>{"scene.create", "push step 0"}));
}

TEST_F(Push, AClientThatVanishesInTheMiddleOfItsRowsLeavesNothing) {
  const std::string whole = frame(FrameType::request, 9, push_of_four().dump(), std::string(64, '\0'));
  anna_.send_bytes(whole.substr(0, whole.size() - 20));
  anna_.close();
  while (bert_.call("status").json["sessions"] != 1) {
  }
  commit(bert_, 0, 2);
  EXPECT_EQ(service_.engine().executed().back(), "push step 0");
}

TEST_F(Push, ASecondPusherIsToldWhoHoldsIt) {
  begin(4);
  bert_.push(0, 4);
  const Received busy = bert_.receive();
  EXPECT_EQ(busy.code(), "busy");
  EXPECT_NE(busy.message().find("'anna'"), std::string::npos) << busy.message();
  EXPECT_NE(busy.message().find("0 of 64 bytes"), std::string::npos) << busy.message();
  anna_.finish(4);
  EXPECT_EQ(anna_.receive().json["report"]["step"], 0);
}

TEST_F(Push, ItsDeadlineGivesItUp) {
  anna_.begin(0, 4, {{"deadline_seconds", 0.2}});
  const Received late = anna_.receive();
  EXPECT_EQ(late.code(), "deadline_exceeded");
  EXPECT_NE(late.message().find("'anna' (0 of 64 bytes have come)"), std::string::npos) << late.message();
  EXPECT_EQ(late.request, 3U);
  anna_.finish(4);  // too late: dropped
  EXPECT_EQ(anna_.call("compare").json["echo"], "compare");
  EXPECT_EQ(service_.engine().executed(), (std::vector<std::string>{"scene.create", "compare"}));
}

TEST_F(Push, ANewerAttemptReplacesTheOlder) {
  Client again = service_.client("anna", kAnna);
  begin(4);
  again.push(0, 4);
  EXPECT_EQ(again.receive().code(), "aborted");  // it isn't newer
  again.begin(0, 4, {{"attempt", 2}});
  EXPECT_EQ(anna_.receive().code(), "aborted");
  anna_.finish(4);  // of the older one: dropped
  again.finish(4);
  EXPECT_EQ(again.receive().json["report"]["step"], 0);
  anna_.call("status");
  EXPECT_EQ(service_.engine().executed(), (std::vector<std::string>{"scene.create", "push step 0"}));
}

TEST_F(Push, ArraysAreThoseOfItsRows) {
  const auto array = [](const char* name, std::uint64_t n, const char* dtype = "<f8") {
    return Json{{"name", name}, {"dtype", dtype}, {"shape", {n}}};
  };
  const std::vector<std::pair<std::size_t, std::vector<Json>>> wrong{
      {48, {array("x", 3), array("y", 3)}},                         // too few particles
      {80, {array("x", 5), array("y", 5)}},                         // too many
      {96, {array("x", 4), array("y", 8)}},                         // of another number
      {64, {array("x", 4), array("z", 4)}},                         // z for y
      {32, {array("x", 4)}},                                        // no y
      {32, {array("x", 4, "<f4"), array("y", 4, "<f4")}},           // another type than said
      {96, {array("x", 4), array("y", 4), array("id", 4, "<i8")}},  // though the push has no ids
      {0, {}},
  };
  for (const auto& [bytes, arrays] : wrong) {
    Json push = push_of_four();
    push["arrays"] = arrays;
    anna_.send(FrameType::request, push, std::string(bytes, '\0'));
    EXPECT_EQ(anna_.receive().code(), "invalid_argument") << push;
  }
  EXPECT_EQ(service_.engine().executed(), kCreated);
  commit(anna_, 0, 4);
}

// Whether or not it is refused.
TEST_F(Push, OneWhoseArraysArentItsBulkEndsTheConnection) {
  for (const std::int64_t step : {0, -1})
    for (const std::size_t bytes : {0U, 56U}) {
      Client client = service_.client("c", kBert);
      Json push = push_of_four();
      push["step"] = step;
      client.send(FrameType::request, push, std::string(bytes, '\0'));
      EXPECT_EQ(client.receive().code(), "protocol_error") << step << ", " << bytes;
      EXPECT_TRUE(client.receive().ended);
    }
  EXPECT_EQ(service_.engine().executed(), kCreated);
}

TEST_F(Push, AWrongChecksumEndsTheConnection) {
  std::string bytes = frame(FrameType::request, 9, push_of_four().dump(), std::string(64, '\0'), true);
  bytes[bytes.size() - 20] = 1;
  anna_.send_bytes(bytes);
  std::string last;
  for (Received received = anna_.receive(); !received.ended; received = anna_.receive()) last = received.code();
  EXPECT_EQ(last, "protocol_error");
  EXPECT_EQ(bert_.call("status").json["steps"], 0);
}

TEST_F(Push, ItIsHeldAgainstTheScene) {
  commit(anna_, 5, 4);
  const std::vector<std::pair<Json, std::string>> wrong{
      {{{"scene", "nobody"}}, "not_found"},
      {{{"n", 3}}, "not_conserved"},
      {{{"n", 5}, {"ids", true}, {"inserted", 2}}, "not_conserved"},
      {{{"n", 3}, {"ids", true}, {"removed", 5}}, "not_conserved"},
      {{{"n", 5}, {"inserted", 1}}, "invalid_argument"},  // without ids
      {{{"n", nullptr}}, "invalid_argument"},
      {{{"counts", {4, 0, 0, 0}}}, "invalid_argument"},  // for what goes to the ranks
      {{{"way", "any"}}, "invalid_argument"},
      {{{"way", "sockets"}, {"counts", {4, 0, 0, 0}}}, "unsupported"},  // not at this endpoint
      {{{"weights", true}}, "invalid_argument"},
      {{{"drifted", 5}}, "invalid_argument"},  // of four rows
      {{{"incarnation", "00000000000000ab"}}, "not_found"},
      {{{"incarnation", "x"}}, "invalid_argument"},
      {{{"step", -1}}, "invalid_argument"},
  };
  for (const auto& [more, code] : wrong) {
    anna_.push(6, 4, more);
    EXPECT_EQ(anna_.receive().code(), code) << more;
  }
  commit(anna_, 6, 4, {{"incarnation", anna_.call("scene.show", {{"scene", "s"}}).json["incarnation"]}});
  commit(anna_, 7, 0, {{"removed", 4}});
  EXPECT_EQ(service_.engine().request()["removed"], 4);
  commit(anna_, 8, 3, {{"inserted", 3}});  // into nothing: as a first push
}

TEST_F(Push, AFirstPushKnowsOfNothingThatCame) {
  commit(anna_, 5, 4, {{"inserted", 2}, {"removed", 1}});
  EXPECT_EQ(service_.engine().request()["inserted"], 0);
  EXPECT_EQ(service_.engine().request()["removed"], 0);
}

TEST_F(Push, AStepThatIsNotAboveTheLastIsNotOrdered) {
  commit(anna_, 4, 4);
  commit(anna_, 5, 4);
  service_.engine().hold();
  anna_.push(5, 4);
  const Received again = anna_.receive_but_notices();
  EXPECT_EQ(again.json["repeated"], true);
  EXPECT_EQ(again.json["report"]["step"], 5);
  bert_.push(5, 4);
  EXPECT_EQ(bert_.receive_but_notices().code(), "stale_step");
  anna_.push(4, 4);
  EXPECT_EQ(anna_.receive_but_notices().code(), "stale_step");
  EXPECT_EQ(service_.engine().executed().size(), 3U);
}

TEST(PushBudget, WhatIsAnnouncedTakesNothingWhatHasArrivedDoes) {
  TestService service([](ControlOptions& options) { options.bulk_bytes_max = std::uint64_t{4} << 20U; });
  Client anna = service.client("anna", kAnna);
  Client bert = service.client("bert", kBert);
  for (const char* scene : {"s", "t", "u"}) anna.call("scene.create", {{"scene", scene}, {"dims", 2}});
  // Announced alone, with no array.
  anna.request("push", {{"scene", "s"}, {"step", 0}, {"n", std::uint64_t{1} << 40U}});
  EXPECT_EQ(anna.receive().code(), "too_large");
  constexpr std::uint64_t kCount = 180000;  // 2.9 MB
  anna.begin(0, kCount, {{"scene", "t"}});
  while (bert.call("count", {{"scene", "t"}, {"step", 0}}).code() != "busy") {
  }
  bert.push(0, kCount, {{"scene", "u"}});
  EXPECT_EQ(bert.receive_but_notices().json["report"]["step"], 0);  // Anna's announcement is in nobody's way
  service.engine().hold();
  bert.push(1, kCount, {{"scene", "u"}});
  service.engine().wait_for_orders(1);  // arrived, and kept until it is answered
  anna.finish(kCount);
  EXPECT_EQ(anna.receive_but_notices().code(), "busy");
  service.engine().release();
  EXPECT_EQ(bert.receive_but_notices().json["report"]["step"], 1);
  anna.push(0, kCount, {{"scene", "t"}});  // all was given back
  EXPECT_EQ(anna.receive_but_notices().json["report"]["step"], 0);
}

TEST(PushBudget, APushThatStopsArrivingIsGivenUp) {
  TestService service([](ControlOptions& options) { options.frame_seconds = 0.3; });
  Client anna = service.client("anna", kAnna);
  Client bert = service.client("bert", kBert);
  anna.call("scene.create", {{"scene", "s"}, {"dims", 2}});
  anna.begin(0, 1000000, {{"deadline_seconds", 3600}});
  const Received failure = anna.receive_but_notices();
  EXPECT_EQ(failure.code(), "deadline_exceeded");
  EXPECT_NE(failure.message().find("stopped arriving"), std::string::npos) << failure.message();
  bert.push(0, 4);
  EXPECT_EQ(bert.receive_but_notices().json["report"]["step"], 0);
}

TEST_F(Push, ADropWaitsForTheOpenPushAndLaterPushesWaitBehindIt) {
  begin(4);
  bert_.request("scene.drop", {{"scene", "s"}});
  Client carl = service_.client("carl", "00000000000000cc");
  while (carl.call("status").json["sessions"] != 3) {
  }
  EXPECT_EQ(service_.engine().executed(), kCreated);
  anna_.finish(4);
  EXPECT_EQ(anna_.receive_but_notices().json["report"]["step"], 0);
  EXPECT_EQ(bert_.receive_but_notices().json["echo"], "scene.drop");
  carl.push(1, 4);
  EXPECT_EQ(carl.receive_but_notices().code(), "not_found");
  EXPECT_EQ(service_.engine().executed(), (std::vector<std::string>{"scene.create", "push step 0", "scene.drop"}));
}

TEST_F(Push, APushBehindAChangeSeesItsEffect) {
  commit(anna_, 5, 4);
  service_.engine().hold();
  anna_.request("scene.create", {{"scene", "s"}, {"dims", 2}, {"replace", true}});
  service_.engine().wait_for_orders(1);
  bert_.push(0, 9);  // another n: refused, were it held against the old scene
  service_.engine().release();
  EXPECT_EQ(bert_.receive_but_notices().json["report"]["step"], 0);
}

TEST_F(Push, ADropThatWaitsTooLongSaysSo) {
  begin(4);
  EXPECT_EQ(bert_.call("scene.drop", {{"scene", "s"}, {"deadline_seconds", 0.2}}).code(), "deadline_exceeded");
  anna_.finish(4);
  EXPECT_EQ(anna_.receive().json["report"]["step"], 0);
  EXPECT_EQ(service_.engine().executed(), (std::vector<std::string>{"scene.create", "push step 0"}));
}

TEST_F(Push, ShutdownAbortsWhatIsOpen) {
  begin(4);
  EXPECT_EQ(bert_.call("shutdown").type, FrameType::reply);
  EXPECT_EQ(anna_.receive().code(), "aborted");
  EXPECT_EQ(anna_.receive().type, FrameType::goodbye);
  EXPECT_EQ(service_.engine().executed(), (std::vector<std::string>{"scene.create", "shutdown"}));
}

}  // namespace
}  // namespace rcb::net::testing
