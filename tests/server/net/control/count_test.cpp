// Steps that are counts: decided and answered on rank 0 with no order to the engine; and questions about positions,
// which wait for the step that brings them.
#include <chrono>
#include <functional>
#include <limits>
#include <map>
#include <thread>
#include <tuple>

#include <gtest/gtest.h>

#include "common/wire/limits.hpp"
#include "tests/server/net/harness.hpp"

namespace rcb::net::testing {
namespace {

using wire::FrameType;
using wire::Json;

template <typename T>
std::string as_bytes(const std::vector<T>& values) {
  return {reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T)};
}

// A count of ten particles in four parts, by the cuts that the engine has after the first push.
struct Record {
  Json json{
      {"command", "count"}, {"scene", "s"}, {"step", 1}, {"epoch", 1}, {"hash", wire::hex64(kCutsHash)}, {"n", 10},
      {"drifted", 2}};
  std::vector<std::int32_t> parts{0, 1, 2, 3};
  std::vector<std::uint64_t> counts{2, 3, 2, 3};
  std::vector<std::uint64_t> loads{};  // low, high; empty: no weights

  Json arrays() const {
    Json specs{{{"name", "part"}, {"dtype", "<i4"}, {"shape", {parts.size()}}},
               {{"name", "count"}, {"dtype", "<u8"}, {"shape", {counts.size()}}}};
    if (!loads.empty()) specs.push_back({{"name", "load"}, {"dtype", "<u8"}, {"shape", {loads.size() / 2, 2}}});
    return specs;
  }
  std::string bulk() const { return as_bytes(parts) + as_bytes(counts) + as_bytes(loads); }
};

class Count : public ::testing::Test {
 protected:
  Count() { create("s", {{"positions", "when-needed"}}); }

  // Anna makes a scene of four parts, and opens it.
  void create(const std::string& scene, const Json& more) {
    Json options{{"scene", scene}, {"dims", 2}, {"parts", 4}, {"tolerance", 0.5}};
    options.update(more);
    const Received made = anna_.call("scene.create", options);
    ASSERT_EQ(made.type, FrameType::reply) << made.message();
    incarnation_ = made.json["incarnation"];
    anna_.call("scene.open", {{"scene", scene}});
  }
  // Ten particles.
  static void begin(Client& client, const char* session, std::int64_t step, const Json& more = Json::object()) {
    client.begin(session, step, 10, more);
  }
  static void finish(Client& client, const char* session, std::int64_t step) {
    client.slice(session, step, 10);
    EXPECT_EQ(client.receive_but_notices().json["report"]["step"], step);
  }
  void push(Client& client, const char* session, std::int64_t step) {
    begin(client, session, step);
    finish(client, session, step);
  }
  // With weights, all of them 0, which the engine doesn't heed.
  void push_weighted(std::int64_t step) {
    begin(anna_, kAnna, step, {{"weights", true}});
    Json slice{
        {"command", "push.slice"}, {"scene", "s"}, {"session", kAnna}, {"step", step}, {"attempt", 1}, {"count", 10}};
    for (const char* name : {"x", "y", "w"})
      slice["arrays"].push_back({{"name", name}, {"dtype", "<f8"}, {"shape", {10}}});
    anna_.send(FrameType::request, slice, std::string(240, '\0'));
    EXPECT_EQ(anna_.receive_but_notices().json["report"]["step"], step);
  }
  Record record(std::int64_t step, const Json& more = Json::object()) const {
    Record record;
    record.json["step"] = step;
    record.json["incarnation"] = incarnation_;
    record.json.update(more);
    return record;
  }
  static void send(Client& client, const Record& record) {
    Json json = record.json;
    json["arrays"] = record.arrays();
    client.send(FrameType::request, std::move(json), record.bulk());
  }
  static Received count(Client& client, const Record& record) {
    send(client, record);
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
  std::string incarnation_;  // of the scene made last
};

TEST_F(Count, IsAnsweredWithNoOrder) {
  push(anna_, kAnna, 0);
  const auto executed = service_.engine().executed();
  service_.engine().hold();
  const Received first = count(anna_, record(1));
  expect_committed(first, 1);
  EXPECT_EQ(first.json["previous_step"], 0);
  EXPECT_EQ(first.json["report"]["sent"], false);
  EXPECT_EQ(first.json["report"]["positions_step"], 0);
  EXPECT_EQ(first.json["report"]["drifted"], 2);
  EXPECT_DOUBLE_EQ(first.json["report"]["error"], 0.2);  // 2 and 3 for 2.5
  Record second = record(2, {{"drifted", nullptr}});
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
  push(anna_, kAnna, 3);
  EXPECT_EQ(bert_.call("scene.show", kScene).json["positions_step"], 3);
}

// A step is counted after what was ordered before it, and seen by what is asked behind it.
TEST_F(Count, WaitsForAnOpenPushAndForChanges) {
  push(anna_, kAnna, 0);
  begin(bert_, kBert, 1);
  bert_.call("status");  // the begin is in
  send(anna_, record(1));
  EXPECT_EQ(anna_.receive().type, FrameType::notice);  // it waits
  finish(bert_, kBert, 1);
  EXPECT_EQ(anna_.receive_but_notices().code(), "stale_step");
  expect_committed(count(anna_, record(2)), 2);
  service_.engine().hold();
  Client carl = service_.client("carl", "00000000000000cc");
  begin(carl, "00000000000000cc", 3);
  carl.slice("00000000000000cc", 3, 10);
  service_.engine().wait_for_orders(1);
  send(anna_, record(4));
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
  push(anna_, kAnna, 0);
  expect_committed(count(anna_, record(1, {{"id_sum", "00000000000000ff"}})), 1);
  const Json before = told();
  Record far = record(2), moved = record(2);
  far.counts = {1, 4, 2, 3};  // 4 of 2.5: an error of 0.6
  const std::vector<std::tuple<Record, std::string, std::string>> refused{
      {record(0), "stale_step", "not above the last one, 1"},
      {record(2, {{"incarnation", "0000000000000001"}}), "not_found", "anew"},
      {record(2, {{"n", 11}}), "invalid_argument", "10 particles together"},
      {record(2, {{"id_sum", "00000000000000fe"}}), "not_conserved", "00000000000000fe"},
      {record(2, {{"scene", "nobody"}}), "not_found", "nobody"},
      {record(2, {{"scene", "../s"}}), "invalid_argument", ""}};
  for (const auto& [one, code, word] : refused) {
    const Received answer = count(word == "not above the last one, 1" ? bert_ : anna_, one);
    EXPECT_EQ(answer.code(), code) << answer.json;
    EXPECT_NE(answer.message().find(word), std::string::npos) << answer.message();
  }
  Record one_more = record(2, {{"n", 11}});
  one_more.counts[0] = 3;
  EXPECT_EQ(count(anna_, one_more).code(), "not_conserved");
  for (const Json& cuts : {Json{{"epoch", 2}}, Json{{"hash", "0000000000000001"}}})
    EXPECT_EQ(count(anna_, record(2, cuts)).json, (Json{{"again", "cuts"}})) << cuts;
  const Received sent = count(anna_, far);
  EXPECT_NE(sent.json.value("send", "").find("error 0.6 has reached the tolerance 0.5"), std::string::npos)
      << sent.json;
  const Received again = count(anna_, record(1));
  EXPECT_EQ(again.json["repeated"], true);
  EXPECT_EQ(again.json["report"]["step"], 1);
  EXPECT_EQ(count(bert_, record(1)).code(), "stale_step") << "of another session";
  EXPECT_EQ(told(), before);
  push(anna_, kAnna, 2);
}

TEST_F(Count, AnEveryStepSceneHasItsPositionsSent) {
  create("e", {{"positions", "every-step"}});
  Record one = record(0, {{"scene", "e"}});
  begin(anna_, kAnna, 0, {{"scene", "e"}});
  anna_.slice(kAnna, 0, 10, {{"scene", "e"}});
  EXPECT_EQ(anna_.receive_but_notices().json["report"]["step"], 0);
  one.json["step"] = 1;
  EXPECT_TRUE(count(anna_, one).json.contains("send"));
  EXPECT_EQ(bert_.call("scene.show", {{"scene", "e"}}).json["step"], 0);
}

// Ten weights of at most 1 have the scale 127 - 1 - 4: with it, a load of 1 is 2^122.
TEST_F(Count, WeightsHaveTheScaleThatIsDue) {
  push_weighted(0);
  constexpr int kScale = 122;
  constexpr std::uint64_t kOne = std::uint64_t{1} << (kScale - 64);
  const Json weights{{"scale", kScale}, {"least", 0.5}, {"greatest", 1}, {"weights_as_zero", 0}};
  const auto weighted = [&](std::int64_t step, Json more) {
    Record one = record(step, weights);
    one.json.update(more);
    one.loads = {0, 2 * kOne, 0, 3 * kOne, 0, 2 * kOne, 0, 3 * kOne};
    return one;
  };
  EXPECT_EQ(count(anna_, record(1)).code(), "invalid_argument") << "weights are there always";
  EXPECT_EQ(count(anna_, weighted(1, {{"scale", 100}})).json, (Json{{"again", "scale"}, {"scale", kScale}}));
  EXPECT_EQ(count(anna_, weighted(1, {{"greatest", 2}})).json["scale"], kScale - 1);
  EXPECT_EQ(bert_.call("scene.show", kScene).json["step"], 0);
  expect_committed(count(anna_, weighted(1, Json::object())), 1);
  EXPECT_EQ(bert_.call("counts", kScene).json["loads"], Json({2.0, 3.0, 2.0, 3.0}));
  // All equal: loads don't count, nor does their scale.
  expect_committed(count(anna_, weighted(2, {{"scale", 5}, {"least", 1}})), 2);
  // No loads at all, though the greatest weight is 1: a lie, and no division by nothing.
  Record none = weighted(3, {{"least", 0}});
  none.loads.assign(8, 0);
  EXPECT_EQ(count(anna_, none).type, FrameType::reply);
}

TEST_F(Count, WhatIsWrongWithARecordByItselfIsRefused) {
  push_weighted(0);
  constexpr std::uint64_t kTooMuch = std::uint64_t{1} << 62U;
  const Json weights{{"scale", 122}, {"least", 0.5}, {"greatest", 1}, {"weights_as_zero", 0}};
  const auto changed = [&](const std::function<void(Record&)>& change) {
    Record one = record(1, weights);
    one.loads.assign(8, 1);
    change(one);
    return one;
  };
  std::vector<Record> wrong;
  const auto add = [&](const std::function<void(Record&)>& change) { wrong.push_back(changed(change)); };
  add([](Record& one) { one.parts = {0, 1, 2, 4}; });  // beyond the last
  add([](Record& one) { one.parts = {0, 1, 2, 2'000'000'000}; });
  add([](Record& one) { one.parts = {-1, 1, 2, 3}; });
  add([](Record& one) { one.parts = {0, 2, 1, 3}; });
  add([](Record& one) { one.parts = {0, 1, 1, 3}; });
  add([](Record& one) { one.counts = {0, 4, 3, 3}; });
  add([](Record& one) { one.counts = {2, 3, 2, 2}; });
  add([](Record& one) { one.counts = {6, std::numeric_limits<std::uint64_t>::max() - 1, 3, 3}; });  // 10 mod 2^64
  add([](Record& one) { one.counts = {2, 3, 5}; });                                                 // too few
  add([](Record& one) { one.loads.assign(6, 1); });
  add([](Record& one) { one.loads = {0, kTooMuch, 0, kTooMuch, 0, 1, 0, 1}; });
  add([](Record& one) { one.loads = {0, 2 * kTooMuch, 0, 0, 0, 0, 0, 0}; });
  add([](Record& one) { one.loads.clear(); });        // weights without array
  add([](Record& one) { one.json.erase("scale"); });  // and an array without weights
  add([](Record& one) { one.parts.clear(), one.counts.clear(), one.loads.clear(); });
  for (const auto& [name, values] : std::map<std::string, Json>{{"n", {-1, 1.5, "10", nullptr, Json::array()}},
                                                                {"step", {-1, wire::kStepMax + 1, "1"}},
                                                                {"drifted", {-1, 11, "2"}},
                                                                {"epoch", {-1, "1"}},
                                                                {"hash", {"", "xyz", 7, "00000000000000000"}},
                                                                {"incarnation", {nullptr, "-1"}},
                                                                {"id_sum", {0, "no"}},
                                                                {"step_seconds", {-1, "inf", "nan", "1"}},
                                                                {"scale", {"122", 122.5, 1301, -1301}},
                                                                {"least", {-1, 1.5, "nan"}},
                                                                {"greatest", {-1, "inf", "1"}},
                                                                {"weights_as_zero", {-1, 11}}})
    for (const Json& value : values) add([&name = name, &value](Record& one) { one.json[name] = value; });
  const Json before = told();
  for (const Record& one : wrong) {
    const Received answer = count(anna_, one);
    EXPECT_EQ(answer.code(), "invalid_argument")
        << one.json << Json(one.parts) << Json(one.counts) << Json(one.loads) << ": " << answer.json;
  }
  EXPECT_EQ(told(), before);
}

TEST_F(Count, ArraysAreOnesThatACountHas) {
  push(anna_, kAnna, 0);
  const Record good = record(1);
  const auto send_as = [&](const Json& arrays, const std::string& bulk) {
    Json json = good.json;
    json["arrays"] = arrays;
    anna_.send(FrameType::request, json, bulk);
    return anna_.receive_but_notices().code();
  };
  const auto changed = [&](std::size_t array, const char* field, const Json& value) {
    Json arrays = good.arrays();
    arrays[array][field] = value;
    return arrays;
  };
  const std::string bulk = good.bulk();
  EXPECT_EQ(send_as(changed(0, "name", "parts"), bulk), "invalid_argument");
  EXPECT_EQ(send_as(changed(0, "dtype", "<f4"), bulk), "invalid_argument");
  EXPECT_EQ(send_as(changed(1, "dtype", "<f8"), bulk), "invalid_argument");
  EXPECT_EQ(send_as(changed(1, "dtype", "<i8"), bulk), "invalid_argument");
  EXPECT_EQ(send_as(changed(0, "shape", {2, 2}), bulk), "invalid_argument");
  EXPECT_EQ(send_as(changed(1, "shape", {4, 1}), bulk), "invalid_argument");
  EXPECT_EQ(send_as(Json{good.arrays()[1], good.arrays()[0]}, as_bytes(good.counts) + as_bytes(good.parts)),
            "invalid_argument");
  Json third = good.arrays();
  third.push_back({{"name", "load"}, {"dtype", "<u8"}, {"shape", {4, 2}}});
  EXPECT_EQ(send_as(third, bulk + std::string(64, '\0')), "invalid_argument");
  // More than 28 bytes a part aren't read: then it is as if they weren't there.
  third[2]["shape"] = {1'000'000, 2};
  Json weighted = good.json;
  weighted.update({{"arrays", third}, {"scale", 1}, {"least", 0}, {"greatest", 1}, {"weights_as_zero", 0}});
  anna_.send(FrameType::request, weighted, bulk + std::string(16'000'000, '\0'));
  const Received refused = anna_.receive_but_notices();
  EXPECT_EQ(refused.code(), "invalid_argument");
  EXPECT_NE(refused.message().find("expected arrays 'part'"), std::string::npos) << refused.message();
  Json json = good.json;
  EXPECT_EQ(anna_.call("count", json).code(), "invalid_argument") << "no arrays";
  json["scene"] = "nobody";
  json["arrays"] = good.arrays();
  anna_.send(FrameType::request, json, bulk);
  EXPECT_EQ(anna_.receive_but_notices().code(), "not_found");
  expect_committed(count(anna_, good), 1);
}

TEST_F(Count, WhatContradictsItselfEndsTheConnection) {
  push(anna_, kAnna, 0);
  Json json = record(1).json;
  json["arrays"] = record(1).arrays();
  const std::string bulk = record(1).bulk();
  const std::string text = json.dump();
  std::string wrong_sum = frame(FrameType::request, 9, text, bulk, true);
  wrong_sum.back() = static_cast<char>(wrong_sum.back() ^ 1);
  std::string not_a_number = text;
  not_a_number.replace(not_a_number.find("\"drifted\":2"), 11, "\"drifted\":NaN");
  for (const std::string& bytes :
       {wrong_sum, frame(FrameType::request, 9, text, bulk.substr(1)), frame(FrameType::request, 9, text),
        frame(FrameType::request, 9, not_a_number, bulk)}) {
    Client client = service_.client("c", kBert);
    client.send_bytes(bytes);
    std::string last;
    for (Received received = client.receive(); !received.ended; received = client.receive()) last = received.code();
    EXPECT_EQ(last, "protocol_error");
  }
  EXPECT_EQ(bert_.call("scene.show", kScene).json["step"], 0);
  anna_.send_bytes(frame(FrameType::request, 9, text, bulk, true));
  expect_committed(anna_.receive_but_notices(), 1);
}

// Anna and bert have a seat each, with five particles.
class SeatCount : public Count {
 protected:
  SeatCount() {
    push(anna_, kAnna, 0);
    anna_.call("scene.open", {{"scene", "s"}, {"seat", 0}, {"seats", 2}});
    bert_.call("scene.open", {{"scene", "s"}, {"seat", 1}, {"seats", 2}});
  }
  std::uint64_t half(Client& client, const Json& more = Json::object()) {
    Record one = record(1, {{"n", 5}, {"id_sum", "0000000000000007"}, {"drifted", nullptr}});
    one.json.update(more);
    one.json["arrays"] = one.arrays();
    one.counts = {1, 1, 1, 1};
    ++one.counts[&client == &anna_ ? 1 : 3];
    return client.send(FrameType::request, one.json, one.bulk());
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
TEST_F(SeatCount, AFaultHasACodeThatIsKnown) {
  for (const Json& fault : {Json::object(), Json{{"code", "internal"}, {"message", "x"}}, Json{{"code", 7}}, Json(7)}) {
    half(anna_);
    anna_.call("scene.list");
    half(bert_, {{"fault", fault}});
    for (Client* one : {&anna_, &bert_}) {
      const Received told = one->receive_but_notices();
      EXPECT_EQ(told.code(), "invalid_argument") << fault << told.json;
      EXPECT_NE(told.message().find("field 'fault'"), std::string::npos) << told.message();
    }
  }
}

// Anna has the scene open, and steps it by counts; bert asks.
class Question : public Count {
 protected:
  Question() {
    push(anna_, kAnna, 0);
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
  push(anna_, kAnna, 2);
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
  push(anna_, kAnna, 0);
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
  push(anna_, kAnna, 2);
  EXPECT_EQ(bert_.receive_but_notices().json["echo"], "rebalance");
}

}  // namespace
}  // namespace rcb::net::testing
