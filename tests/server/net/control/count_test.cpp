// Steps that are counts: decided and answered on rank 0 with no order to the engine; and questions about positions,
// which wait for the step that brings them.
#include <chrono>
#include <functional>
#include <thread>
#include <tuple>

#include <gtest/gtest.h>

#include "common/wire/count_record.hpp"
#include "tests/server/net/harness.hpp"

namespace rcb::net::testing {
namespace {

using wire::CountRecord;
using wire::FrameType;
using wire::Json;

using Change = std::function<void(CountRecord&)>;

class Count : public ::testing::Test {
 protected:
  Count() { create("s", {{"positions", "when-needed"}}); }

  // Anna makes a scene of four parts, and opens it.
  void create(const std::string& scene, const Json& more) {
    Json options{{"scene", scene}, {"dims", 2}, {"parts", 4}, {"tolerance", 0.5}};
    options.update(more);
    const Received made = anna_.call("scene.create", options);
    ASSERT_EQ(made.type, FrameType::reply) << made.message();
    incarnation_ = *wire::parse_hex64(made.json["incarnation"].get<std::string>());
    anna_.call("scene.open", {{"scene", scene}});
  }
  // Ten particles.
  static void push(Client& client, std::int64_t step, const Json& more = Json::object()) {
    client.push(step, 10, more);
    EXPECT_EQ(client.receive_but_notices().json["report"]["step"], step);
  }
  // With weights, all of them 0, which the engine doesn't heed.
  void push_weighted(std::int64_t step) {
    Json json{{"command", "push"}, {"scene", "s"}, {"step", step}, {"n", 10}, {"weights", true}};
    for (const char* name : {"x", "y", "w"})
      json["arrays"].push_back({{"name", name}, {"dtype", "<f8"}, {"shape", {10}}});
    anna_.send(FrameType::request, json, std::string(240, '\0'));
    EXPECT_EQ(anna_.receive_but_notices().json["report"]["step"], step);
  }
  // Ten particles in four parts, by the cuts that the engine has after the first push.
  CountRecord record(std::int64_t step, const Change& change = {}) const {
    CountRecord record{step, incarnation_, 1, kCutsHash, 10};
    record.drifted = 2;
    record.parts = {0, 1, 2, 3};
    record.counts = {2, 3, 2, 3};
    if (change) change(record);
    return record;
  }
  // With weights of at most 1, and the scale 127 - 1 - 4 of ten particles.
  CountRecord weighted(std::int64_t step, const Change& change = {}) const {
    return record(step, [&](CountRecord& one) {
      constexpr u128 kOne = u128{1} << 122U;
      one.weights = wire::WeightCount{122, 0.5, 1, 0, {2 * kOne, 3 * kOne, 2 * kOne, 3 * kOne}};
      if (change) change(one);
    });
  }
  static std::uint64_t send(Client& client, const std::string& bulk, const Json& more = Json::object(),
                            bool checked = false) {
    Json json{{"command", "count"}, {"scene", "s"}};
    json.update(more);
    return client.send(FrameType::request, std::move(json), bulk, checked);
  }
  static Received count(Client& client, const CountRecord& record, const Json& more = Json::object()) {
    send(client, encode(record), more);
    return client.receive_but_notices();
  }
  void expect_committed(const Received& answer, std::int64_t step) {
    EXPECT_EQ(answer.type, FrameType::reply) << answer.message();
    EXPECT_EQ(answer.json.value("/report/step"_json_pointer, Json()), step) << answer.json;
    EXPECT_EQ(answer.json.value("/report/way"_json_pointer, Json()), "count") << answer.json;
  }
  // All that is told of the scene.
  Json told() {
    Json all;
    for (const char* command : {"scene.show", "stats", "history"}) all[command] = bert_.call(command, kScene).json;
    return all;
  }

  const Json kScene{{"scene", "s"}};
  TestService service_{[](ControlOptions& options) { options.notice_seconds = 0.05; }};
  Client anna_ = service_.client("anna", kAnna);
  Client bert_ = service_.client("bert", kBert);
  std::uint64_t incarnation_ = 0;  // of the scene made last
};

TEST_F(Count, IsAnsweredWithNoOrder) {
  push(anna_, 0);
  const auto executed = service_.engine().executed();
  service_.engine().hold();
  const Received first = count(anna_, record(1));
  expect_committed(first, 1);
  EXPECT_EQ(first.json["previous_step"], 0);
  EXPECT_EQ(first.json["report"]["sent"], false);
  EXPECT_EQ(first.json["report"]["positions_step"], 0);
  EXPECT_EQ(first.json["report"]["drifted"], 2);
  EXPECT_DOUBLE_EQ(first.json["report"]["error"], 0.2);  // 2 and 3 for 2.5
  CountRecord second = record(2);
  second.drifted.reset();
  second.parts = {0, 1, 3};
  second.counts = {3, 4, 3};
  EXPECT_NE(count(anna_, second).json.value("send", "").find("error 1 "), std::string::npos) << "of an empty part";
  second.parts = {0, 1, 2, 3};
  second.counts = {3, 2, 3, 2};
  const Received answer = count(anna_, second);
  expect_committed(answer, 2);
  EXPECT_EQ(answer.json["previous_step"], 1);
  EXPECT_TRUE(answer.json["report"]["drifted"].is_null());
  const Received shown = bert_.call("scene.show", kScene);
  EXPECT_EQ(shown.json["step"], 2);
  EXPECT_EQ(shown.json["positions_step"], 0);
  EXPECT_EQ(shown.json["counts"], Json({3, 2, 3, 2}));
  EXPECT_EQ(bert_.call("stats", kScene).json["steps"], 3);
  EXPECT_EQ(bert_.call("history", kScene).json["history"].size(), 3U);
  EXPECT_EQ(bert_.call("status").json["steps"], 3);
  EXPECT_EQ(service_.engine().executed(), executed);
  service_.engine().release();
  push(anna_, 3);
  EXPECT_EQ(bert_.call("scene.show", kScene).json["positions_step"], 3);
}

// A step is counted after what was ordered before it, and seen by what is asked behind it.
TEST_F(Count, WaitsForChangesAndIsRefusedWhileAnotherPushes) {
  push(anna_, 0);
  bert_.begin(1, 10);
  while (anna_.call("count", {{"scene", "s"}, {"step", 1}}).code() != "busy") {  // until that is in
  }
  EXPECT_EQ(count(anna_, record(1)).code(), "busy");
  bert_.finish(10);
  EXPECT_EQ(bert_.receive_but_notices().json["report"]["step"], 1);
  EXPECT_EQ(count(anna_, record(1)).code(), "stale_step");
  expect_committed(count(anna_, record(2)), 2);
  service_.engine().hold();
  Client carl = service_.client("carl", "00000000000000cc");
  carl.push(3, 10);
  service_.engine().wait_for_orders(1);
  send(anna_, encode(record(4)));
  EXPECT_EQ(anna_.receive().type, FrameType::notice);
  bert_.request("scene.show", kScene);
  EXPECT_EQ(bert_.receive().type, FrameType::notice);
  service_.engine().release();
  expect_committed(anna_.receive_but_notices(), 4);
  EXPECT_EQ(carl.receive_but_notices().json["report"]["step"], 3);
  EXPECT_GE(bert_.receive_but_notices().json["step"], 3);
}

TEST_F(Count, WhatIsNotCommittedChangesNothing) {
  EXPECT_EQ(count(anna_, record(0)).json["send"], "first positions");
  EXPECT_EQ(bert_.call("history", kScene).json["total"], 0);
  push(anna_, 0);
  expect_committed(count(anna_, record(1, [](CountRecord& one) { one.id_sum = 0xff; })), 1);
  const Json before = told();
  const std::vector<std::tuple<Change, std::string, std::string>> refused{
      {[](CountRecord& one) { one.incarnation = 1; }, "not_found", "anew"},
      {[](CountRecord& one) { ++one.n; }, "invalid_argument", "10 particles together"},
      {[](CountRecord& one) { ++one.n, ++one.counts[0]; }, "not_conserved", "11 particles brought"},
      {[](CountRecord& one) { one.id_sum = 0xfe; }, "not_conserved", "00000000000000fe"}};
  for (const auto& [change, code, word] : refused) {
    const Received answer = count(anna_, record(2, change));
    EXPECT_EQ(answer.code(), code) << answer.json;
    EXPECT_NE(answer.message().find(word), std::string::npos) << answer.message();
  }
  EXPECT_NE(count(bert_, record(0)).message().find("not above the last one, 1"), std::string::npos);
  for (const char* name : {"nobody", "../s"})
    EXPECT_EQ(count(anna_, record(2), {{"scene", name}}).code(), "not_found") << name;
  for (const Json& name : {Json(7), Json()})
    EXPECT_EQ(count(anna_, record(2), {{"scene", name}}).code(), "invalid_argument") << name;
  for (const Change& cuts :
       {Change([](CountRecord& one) { one.epoch = 2; }), Change([](CountRecord& one) { one.hash = 1; })})
    EXPECT_EQ(count(anna_, record(2, cuts)).json, (Json{{"again", "cuts"}}));
  // 4 of 2.5: an error of 0.6
  const Received sent = count(anna_, record(2, [](CountRecord& one) { one.counts = {1, 4, 2, 3}; }));
  EXPECT_NE(sent.json.value("send", "").find("error 0.6 has reached the tolerance 0.5"), std::string::npos)
      << sent.json;
  const Received again = count(anna_, record(1));
  EXPECT_EQ(again.json["repeated"], true);
  EXPECT_EQ(again.json["report"]["step"], 1);
  EXPECT_EQ(count(bert_, record(1)).code(), "stale_step") << "of another session";
  EXPECT_EQ(told(), before);
  push(anna_, 2);
}

TEST_F(Count, AnEveryStepSceneHasItsPositionsSent) {
  create("e", {{"positions", "every-step"}});
  push(anna_, 0, {{"scene", "e"}});
  EXPECT_TRUE(count(anna_, record(1), {{"scene", "e"}}).json.contains("send"));
  EXPECT_EQ(bert_.call("scene.show", {{"scene", "e"}}).json["step"], 0);
}

TEST_F(Count, WeightsHaveTheScaleThatIsDue) {
  push_weighted(0);
  EXPECT_EQ(count(anna_, record(1)).code(), "invalid_argument") << "weights are there always";
  const auto other_scale = weighted(1, [](CountRecord& one) { one.weights->scale = 100; });
  EXPECT_EQ(count(anna_, other_scale).json, (Json{{"again", "scale"}, {"scale", 122}}));
  EXPECT_EQ(count(anna_, weighted(1, [](CountRecord& one) { one.weights->greatest = 2; })).json["scale"], 121);
  EXPECT_EQ(bert_.call("scene.show", kScene).json["step"], 0);
  expect_committed(count(anna_, weighted(1)), 1);
  EXPECT_EQ(bert_.call("counts", kScene).json["loads"], Json({2.0, 3.0, 2.0, 3.0}));
  // All equal: loads don't count, nor does their scale.
  const auto equal = weighted(2, [](CountRecord& one) {
    one.weights->scale = 5;
    one.weights->least = 1;
  });
  expect_committed(count(anna_, equal), 2);
  // No loads at all, though the greatest weight is 1: a lie, and no division by nothing.
  EXPECT_EQ(count(anna_, weighted(3, [](CountRecord& one) { one.weights->loads.assign(4, 0); })).type,
            FrameType::reply);
}

TEST_F(Count, ARecordThatIsWrongIsRefused) {
  push_weighted(0);
  const Json before = told();
  const auto refuses = [&](const std::string& message, const std::string& bulk, bool checked = false) {
    send(anna_, bulk, Json::object(), checked);
    const Received answer = anna_.receive_but_notices();
    EXPECT_EQ(answer.code(), "invalid_argument") << answer.json;
    EXPECT_NE(answer.message().find(message), std::string::npos) << answer.message();
  };
  refuses("a record of 0 bytes", "");
  refuses("not rows", encode(record(1)) + "byte");
  refuses("and n is 10", encode(weighted(1, [](CountRecord& one) { --one.counts[0]; })));
  refuses("part 4, and the scene has 4", encode(weighted(1, [](CountRecord& one) { one.parts.back() = 4; })));
  constexpr u128 kTooMuch = u128{1} << 126U;
  refuses("127 bits", encode(weighted(1, [](CountRecord& one) { one.weights->loads = {kTooMuch, kTooMuch, 1, 1}; })));
  // More than four parts need isn't read.
  const std::string good = encode(weighted(1));
  refuses("a record of 249 bytes, and the scene has 4 parts", good + '\0');
  for (const bool checked : {false, true})
    refuses("a record of 16000248 bytes", good + std::string(16'000'000, '\0'), checked);
  EXPECT_EQ(told(), before);
  send(anna_, good, Json::object(), true);
  expect_committed(anna_.receive_but_notices(), 1);
}

TEST_F(Count, WhatContradictsItselfEndsTheConnection) {
  push(anna_, 0);
  const std::string bulk = encode(record(1));
  std::string text = R"({"command":"count","scene":"s"})";
  std::string wrong_sum = frame(FrameType::request, 9, text, bulk, true);
  wrong_sum.back() = static_cast<char>(wrong_sum.back() ^ 1);
  const std::string whole = frame(FrameType::request, 9, text, bulk);
  text.back() = ',';
  const std::string not_a_number = frame(FrameType::request, 9, text + R"("step":NaN})", bulk);
  for (const std::string& bytes : {wrong_sum, not_a_number}) {
    Client client = service_.client("c", kBert);
    client.send_bytes(bytes);
    std::string last;
    for (Received received = client.receive(); !received.ended; received = client.receive()) last = received.code();
    EXPECT_EQ(last, "protocol_error");
  }
  Client cut_off = service_.client("c", kBert);
  cut_off.send_bytes(whole.substr(0, whole.size() - 1));
  cut_off.close();
  EXPECT_EQ(bert_.call("scene.show", kScene).json["step"], 0);
  anna_.send_bytes(whole);
  expect_committed(anna_.receive_but_notices(), 1);
}

// Anna and bert have a seat each, with five particles.
class SeatCount : public Count {
 protected:
  SeatCount() {
    push(anna_, 0);
    anna_.call("scene.open", {{"scene", "s"}, {"seat", 0}, {"seats", 2}});
    bert_.call("scene.open", {{"scene", "s"}, {"seat", 1}, {"seats", 2}});
  }
  std::uint64_t half(Client& client, const Json& more = Json::object()) {
    const auto one = record(1, [&](CountRecord& half) {
      half.n = 5;
      half.id_sum = 7;
      half.drifted.reset();
      half.counts = {1, 1, 1, 1};
      ++half.counts[&client == &anna_ ? 1 : 3];
    });
    return send(client, encode(one), more);
  }
};

TEST_F(SeatCount, ASecondOneOfASeatReplacesTheFirstWhichIsAnswered) {
  const std::uint64_t older = half(anna_, {{"deadline_seconds", 0.3}});
  const std::uint64_t newer = half(anna_);
  const Received replaced = anna_.receive_but_notices();
  EXPECT_EQ(replaced.request, older);
  EXPECT_EQ(replaced.code(), "aborted");
  std::this_thread::sleep_for(std::chrono::milliseconds(400));  // the older one's deadline is nobody's
  half(bert_);
  const Received answer = anna_.receive_but_notices();
  EXPECT_EQ(answer.request, newer);
  expect_committed(answer, 1);
  expect_committed(bert_.receive_but_notices(), 1);
}

// What one seat says is told to all: a word that means nothing isn't a bug of the service.
TEST_F(SeatCount, AFaultHasAStepAndACodeThatIsKnown) {
  for (const Json& step : {Json(), Json(-1), Json("1")}) {
    const Received refused = bert_.call("count", {{"scene", "s"}, {"step", step}, {"fault", Json::object()}});
    EXPECT_NE(refused.message().find("field 'step'"), std::string::npos) << refused.json;
  }
  for (const Json& fault : {Json::object(), Json{{"code", "internal"}, {"message", "x"}}, Json{{"code", 7}}, Json(7)}) {
    half(anna_);
    anna_.call("scene.list");
    bert_.request("count", {{"scene", "s"}, {"step", 1}, {"fault", fault}});
    for (Client* one : {&anna_, &bert_}) {
      const Received told = one->receive_but_notices();
      EXPECT_EQ(told.code(), "invalid_argument") << fault << told.json;
      EXPECT_NE(told.message().find("field 'fault'"), std::string::npos) << told.message();
    }
  }
}

TEST_F(SeatCount, AFaultEndsAStepThatOthersPush) {
  anna_.begin(1, 0);
  anna_.call("scene.list");
  bert_.request("count", {{"scene", "s"}, {"step", 1}, {"fault", {{"code", "not_finite"}, {"message", "x is nan"}}}});
  for (Client* one : {&anna_, &bert_}) {
    const Received told = one->receive_but_notices();
    EXPECT_EQ(told.code(), "not_finite") << told.json;
  }
}

TEST_F(SeatCount, APushOfAnotherStepLeavesWhatIsCounted) {
  half(anna_);
  anna_.call("scene.list");
  bert_.begin(2, 0);
  EXPECT_EQ(bert_.receive_but_notices().code(), "invalid_argument");
  half(bert_);
  expect_committed(anna_.receive_but_notices(), 1);
  expect_committed(bert_.receive_but_notices(), 1);
}

// Anna has the scene open, and steps it by counts; bert asks.
class Question : public Count {
 protected:
  Question() {
    push(anna_, 0);
    expect_committed(count(anna_, record(1)), 1);
  }
  // It waits once its notice has come.
  std::uint64_t ask(const std::string& command, Json more = Json::object()) {
    more["scene"] = "s";
    const std::uint64_t number = bert_.request(command, std::move(more));
    const Received notice = bert_.receive();
    EXPECT_EQ(notice.type, FrameType::notice) << notice.json;
    EXPECT_NE(notice.json.value("notice", "").find("positions of the next step"), std::string::npos) << notice.json;
    return number;
  }
  std::vector<std::string> orders() { return service_.engine().executed(); }
  const std::vector<std::string> kBefore{"scene.create", "push step 0"};
};

TEST_F(Question, WaitsForThePositionsOfTheNextStepWhichIsSent) {
  const std::uint64_t number = ask("assign");
  const Received sent = count(anna_, record(2));
  EXPECT_NE(sent.json.value("send", "").find("question"), std::string::npos) << sent.json;
  EXPECT_EQ(orders(), kBefore);
  push(anna_, 2);
  const Received answer = bert_.receive_but_notices();
  EXPECT_EQ(answer.request, number);
  EXPECT_EQ(answer.json["echo"], "assign");
  EXPECT_EQ(orders(), (std::vector<std::string>{"scene.create", "push step 0", "push step 2", "assign"}));
  expect_committed(count(anna_, record(3)), 3);  // it is asked for once
}

TEST_F(Question, OfAnyKindWaitsButAboutWhatTheLedgerKnows) {
  for (const char* command : {"fetch", "quality", "compare", "halo", "write_parts"}) {
    SCOPED_TRACE(command);
    Client asker = service_.client("asker", kBert);
    asker.request(command, {{"scene", "s"}});
    EXPECT_EQ(asker.receive().type, FrameType::notice);
  }
  for (const char* command : {"error", "counts", "stats", "history", "scene.show", "cuts", "box", "neighbours"})
    EXPECT_EQ(bert_.call(command, kScene).type, FrameType::reply) << command;
}

TEST_F(Question, TakesWhatIsHeldIfItSaysSo) {
  EXPECT_EQ(bert_.call("assign", {{"scene", "s"}, {"held", true}}).json["echo"], "assign");
  EXPECT_FALSE(service_.engine().request().contains("seats"));
  EXPECT_EQ(bert_.call("assign", {{"scene", "s"}, {"held", "yes"}}).code(), "invalid_argument");
  expect_committed(count(anna_, record(2)), 2);
}

TEST_F(Question, WaitsForNobodyWhereTheAskerStepsTheScene) {
  EXPECT_EQ(anna_.call("assign", kScene).json["echo"], "assign");
  bert_.call("scene.open", kScene);
  EXPECT_EQ(bert_.call("assign", kScene).json["echo"], "assign") << "who has it open would wait for itself";
  expect_committed(count(anna_, record(2)), 2);
}

TEST_F(Question, IsAnsweredFromWhatIsHeldOnceNobodyElseHasTheSceneOpen) {
  ask("assign");
  EXPECT_EQ(orders(), kBefore);
  anna_.call("scene.close", kScene);
  EXPECT_EQ(bert_.receive_but_notices().json["echo"], "assign");
  anna_.call("scene.open", kScene);
  ask("assign");
  anna_.close();
  EXPECT_EQ(bert_.receive_but_notices().json["echo"], "assign");
}

TEST_F(Question, EndsAtItsDeadline) {
  ask("assign", {{"deadline_seconds", 0.3}});
  const Received late = bert_.receive_but_notices();
  EXPECT_EQ(late.code(), "deadline_exceeded");
  EXPECT_NE(late.hint().find("--held"), std::string::npos) << late.hint();
  EXPECT_EQ(orders(), kBefore);
}

TEST_F(Question, EndsWithItsSceneAndWithTheService) {
  ask("assign");
  EXPECT_EQ(anna_.call("scene.drop", kScene).type, FrameType::reply);
  bert_.receive_but_notices();  // the engine's answer, whatever it is
  create("s", {{"positions", "when-needed"}});
  push(anna_, 0);
  expect_committed(count(anna_, record(1)), 1);
  ask("assign");
  anna_.call("shutdown");
  EXPECT_EQ(bert_.receive_but_notices().code(), "unavailable");
}

TEST_F(Question, ARebalanceOfHeldPositionsIsRefused) {
  const Received refused = bert_.call("rebalance", {{"scene", "s"}, {"held", true}});
  EXPECT_EQ(refused.code(), "invalid_argument");
  EXPECT_NE(refused.message().find("step 0"), std::string::npos) << refused.message();
  EXPECT_EQ(bert_.call("rebalance", {{"scene", "s"}, {"held", true}, {"dry_run", true}}).json["echo"], "rebalance");
  ask("rebalance");
  EXPECT_TRUE(count(anna_, record(2)).json.contains("send"));
  push(anna_, 2);
  EXPECT_EQ(bert_.receive_but_notices().json["echo"], "rebalance");
}

}  // namespace
}  // namespace rcb::net::testing
