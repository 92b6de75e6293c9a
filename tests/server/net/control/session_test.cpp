// Sessions: who gets in, what a broken frame does, and who may have which scene.
#include <thread>

#include <gtest/gtest.h>

#include "common/base/random.hpp"
#include "tests/server/net/harness.hpp"

namespace rcb::net::testing {
namespace {

using wire::FrameType;
using wire::Json;

// The last words of a connection that the service ends: a failure, then nothing.
std::string last_failure(Client& client) {
  std::string code;
  while (true) {
    const Received received = client.receive();
    if (received.ended) return code;
    if (received.type == FrameType::failure) code = received.code();
  }
}

void expect_alive(TestService& service) {
  Client client = service.client("prober");
  EXPECT_EQ(client.call("status").type, FrameType::reply);
}

TEST(Session, SaysWelcomeAndAnswersHello) {
  TestService service;
  Client client = service.connect();
  const Received welcome = client.receive();
  EXPECT_EQ(welcome.type, FrameType::welcome);
  EXPECT_EQ(welcome.request, 0U);
  EXPECT_EQ(welcome.json["authentication"], "none");
  EXPECT_EQ(welcome.json.size(), 4U) << "before hello nothing is told that hello doesn't need: " << welcome.json;
  client.send(FrameType::hello, {{"protocol", 2}, {"client", "c"}, {"session", kAnna}, {"new", "field"}});
  const Received reply = client.receive();
  EXPECT_EQ(reply.type, FrameType::reply);
  EXPECT_EQ(reply.json["ranks"], 4);
  EXPECT_EQ(reply.json["version"], "test");
  EXPECT_EQ(reply.json["limits"]["sessions"], 1280);
  EXPECT_EQ(reply.json["session"], kAnna);
}

TEST(Session, NothingIsUnderstoodBeforeHello) {
  TestService service;
  Client client = service.connect();
  client.request("status");
  EXPECT_EQ(last_failure(client), "protocol_error");
  for (const Json& hello : {Json{{"protocol", 1}, {"client", "c"}, {"session", kAnna}},
                            Json{{"protocol", 2}, {"client", "c"}, {"session", "zz"}},
                            Json{{"protocol", 2}, {"client", 7}, {"session", kAnna}}, Json::object()}) {
    Client other = service.connect();
    other.send(FrameType::hello, hello);
    EXPECT_EQ(last_failure(other), "protocol_error") << hello;
  }
  expect_alive(service);
}

TEST(Session, LimitsBeforeHelloAreSmall) {
  TestService service([](ControlOptions& options) { options.hello_seconds = 0.3; });
  Client large = service.connect();
  large.send(FrameType::hello, {{"protocol", 2}, {"client", std::string(5000, 'c')}, {"session", kAnna}});
  EXPECT_EQ(last_failure(large), "too_large");
  Client bulky = service.connect();
  bulky.send(FrameType::hello, {{"protocol", 2}, {"client", "c"}, {"session", kAnna}}, "bulk");
  EXPECT_EQ(last_failure(bulky), "too_large");
  Client silent = service.connect();
  EXPECT_EQ(last_failure(silent), "protocol_error");
  Client slow = service.connect();  // a byte now and then doesn't extend it
  slow.send_bytes("R");
  EXPECT_EQ(last_failure(slow), "protocol_error");
  expect_alive(service);
}

TEST(Session, RandomBytesEndTheirOwnConnectionOnly) {
  TestService service([](ControlOptions& options) {
    options.frame_seconds = 0.2;
    options.hello_seconds = 0.2;
  });
  Client witness = service.client("witness");
  const std::uint64_t seed = 20240601;
  SCOPED_TRACE(seed);
  Random random(seed);
  for (int round = 0; round < 40; ++round) {
    Client client = service.connect();
    if (random.below(2) == 0) client.hello("r", kAnna);
    std::string bytes = frame(FrameType::request, 1, R"({"command":"status"})");
    if (random.below(2) == 0) {  // a good frame with bytes of it changed
      for (int i = 0; i < 3; ++i) bytes[random.below(bytes.size())] = static_cast<char>(random.below(256));
    } else {
      bytes.assign(random.below(300), '\0');
      for (char& byte : bytes) byte = static_cast<char>(random.below(256));
    }
    client.send_bytes(bytes);
    if (random.below(4) == 0) continue;  // gone at once
    client.close();
    ASSERT_EQ(witness.call("status").type, FrameType::reply) << "round " << round;
  }
}

TEST(Session, HalfAFrameIsGivenUp) {
  TestService service([](ControlOptions& options) { options.frame_seconds = 0.3; });
  const std::string whole = frame(FrameType::request, 1, R"({"command":"status"})");
  for (const std::size_t part : {std::size_t{1}, std::size_t{39}, std::size_t{45}}) {
    Client client = service.client("c");
    client.send_bytes(whole.substr(0, part));
    EXPECT_EQ(last_failure(client), "deadline_exceeded") << part;
  }
  Client idle = service.client("idle");  // between frames there is no deadline
  Client other = service.client("other");
  other.send_bytes(whole.substr(0, 10));
  last_failure(other);
  EXPECT_EQ(idle.call("status").type, FrameType::reply);
}

TEST(Session, BreachesAreAnsweredAndEndTheConnection) {
  TestService service;
  std::string huge_json = frame(FrameType::request, 1, "{}");
  huge_json[15] = 0x7f;  // json_bytes
  std::string huge_bulk = frame(FrameType::request, 1, "{}");
  huge_bulk[31] = 0x7f;  // bulk_bytes
  std::string bad_sum = frame(FrameType::request, 1, R"({"command":"status"})");
  bad_sum.back() = ']';
  const std::vector<std::pair<std::string, std::string>> cases{
      {huge_json, "too_large"},
      {huge_bulk, "too_large"},
      {bad_sum, "protocol_error"},
      {frame(FrameType::request, 1, "[]"), "protocol_error"},
      {frame(FrameType::request, 1, "{\"a\":"), "protocol_error"},
      {frame(FrameType::reply, 1, "{}"), "protocol_error"},
      {frame(FrameType::hello, 1, "{}"), "protocol_error"}};
  for (const auto& [bytes, code] : cases) {
    Client client = service.client("c");
    client.send_bytes(bytes);
    EXPECT_EQ(last_failure(client), code);
  }
  expect_alive(service);
  EXPECT_TRUE(service.engine().executed().empty());
}

TEST(Session, RefusedRequestsLeaveTheConnection) {
  TestService service;
  Client client = service.client("c");
  EXPECT_EQ(client.call("compare", {{"deadline_seconds", -1}}).code(), "invalid_argument");
  EXPECT_EQ(client.call("push.begin").code(), "unsupported");
  client.send(FrameType::request, {{"no", "command"}});
  EXPECT_EQ(client.receive().code(), "invalid_argument");
  EXPECT_EQ(client.call("scene.close", {{"scene", "s"}}).code(), "not_found");
  EXPECT_EQ(client.call("scene.drop", {{"scene", "../x"}}).code(), "invalid_argument");
  const wire::Json array{{"name", "x"}, {"dtype", "<f8"}, {"shape", {3}}};
  client.send(FrameType::request, {{"command", "compare"}, {"arrays", {array}}}, "bulk that nobody asked f", true);
  EXPECT_EQ(client.receive().json["echo"], "compare");
}

TEST(Session, AnswersInOrderAndEchoesTheRequest) {
  TestService service;
  Client client = service.client("c");
  std::vector<std::uint64_t> sent;
  for (int i = 0; i < 20; ++i) sent.push_back(client.request(i % 2 == 0 ? "compare" : "status"));
  for (const std::uint64_t number : sent) EXPECT_EQ(client.receive().request, number);
}

TEST(Session, StatusIsAnsweredWhileTheEngineIsBusy) {
  TestService service;
  Client anna = service.client("anna");
  anna.call("scene.create", {{"scene", "s"}});
  service.engine().hold();
  anna.request("compare", {{"scene", "s"}});
  Client bert = service.client("bert", kBert);
  const Received status = bert.call("status");
  EXPECT_EQ(status.json["scenes"][0]["scene"], "s");
  EXPECT_EQ(status.json["sessions"], 2);
  EXPECT_FALSE(status.json["empty"]);
  EXPECT_EQ(bert.call("scene.list").json["scenes"].size(), 1U);
  service.engine().release();
  EXPECT_EQ(anna.receive_but_notices().json["echo"], "compare");
}

TEST(Session, TooManyOrdersAreBusyBeforeOrdering) {
  TestService service([](ControlOptions& options) { options.orders_max = 3; });
  service.engine().hold();
  std::vector<Client> clients;
  for (int i = 0; i < 3; ++i) clients.push_back(service.client("c"));
  for (Client& client : clients) client.request("compare");
  Client late = service.client("late");
  service.engine().wait_for_orders(3);
  EXPECT_EQ(late.call("compare").code(), "busy");
  service.engine().release();
  for (Client& client : clients) EXPECT_EQ(client.receive_but_notices().json["echo"], "compare");
  EXPECT_EQ(late.call("compare").json["echo"], "compare");
}

TEST(Session, AWaitHasADeadlineAndNotices) {
  TestService service([](ControlOptions& options) { options.notice_seconds = 0.1; });
  service.engine().hold();
  Client client = service.client("c");
  client.request("compare", {{"deadline_seconds", 0.5}});
  const Received notice = client.receive();
  EXPECT_EQ(notice.type, FrameType::notice);
  EXPECT_NE(notice.json["notice"].get<std::string>().find("compare"), std::string::npos);
  EXPECT_EQ(client.receive_but_notices().code(), "deadline_exceeded");
  service.engine().release();
  EXPECT_EQ(client.call("neighbours").json["echo"], "neighbours");  // the late answer went nowhere
}

TEST(Session, ACommandIsCancelledOnceItsClientHasGone) {
  TestService service;
  for (const bool tcp : {false, true}) {
    service.engine().hold();
    {
      Client client = tcp ? Client::on_tcp(service.tcp()) : service.connect();
      client.hello("gone", kAnna, tcp ? std::string(64, 'a') : "");
      client.request("compare", {{"scene", "s"}, {"deadline_seconds", 600}});
      service.engine().wait_for_orders(1);
    }
    service.engine().wait_for_cancelled();
    service.engine().release();
    EXPECT_EQ(service.client("next").call("compare").json["echo"], "compare");
  }
}

TEST(Session, WhatAClientAskedBeforeItWentIsNotOrdered) {
  TestService service;
  Client witness = service.client("witness", kBert);
  Client client = service.client("gone");
  service.engine().hold();
  for (int k = 0; k < 100; ++k) client.request("assign", {{"scene", "s"}});
  service.engine().wait_for_orders(1);
  client.close();
  service.engine().wait_for_cancelled();
  const std::uint64_t asked = witness.request("compare", {{"scene", "s"}});
  service.engine().wait_for_orders(2);
  service.engine().release();
  EXPECT_EQ(witness.receive_but_notices().request, asked);
  EXPECT_EQ(service.engine().executed(), (std::vector<std::string>{"assign", "compare"}));
}

TEST(Session, AnOpenSceneIsNotTakenFromUnderItsClient) {
  TestService service;
  Client anna = service.client("anna", kAnna);
  Client bert = service.client("bert", kBert);
  anna.call("scene.create", {{"scene", "s"}});
  EXPECT_EQ(anna.call("scene.open", {{"scene", "s"}}).json["holders"], Json({"anna"}));
  for (const auto& [command, more] :
       {std::pair("scene.drop", Json::object()), std::pair("scene.create", Json{{"replace", true}}),
        std::pair("load", Json{{"path", "/points.csv"}})}) {
    Json arguments{{"scene", "s"}};
    arguments.update(more);
    const Received refused = bert.call(command, arguments);
    EXPECT_EQ(refused.code(), "busy") << command;
    EXPECT_NE(refused.message().find("anna"), std::string::npos) << refused.message();
  }
  EXPECT_EQ(anna.call("scene.create", {{"scene", "s"}, {"replace", true}}).type, FrameType::reply);
  EXPECT_EQ(anna.call("scene.close", {{"scene", "s"}}).type, FrameType::reply);
  EXPECT_EQ(bert.call("scene.drop", {{"scene", "s"}}).type, FrameType::reply);
  EXPECT_EQ(bert.call("scene.open", {{"scene", "s"}}).code(), "not_found");
  EXPECT_EQ(anna.call("scene.create", {{"scene", "s"}}).json["holders"], Json::array());  // bert doesn't hold it
}

// Who has a scene open knows its number of parts, and may count by it.
TEST(Session, AnOpenScenesPartsAreNotChangedFromUnderItsClient) {
  TestService service;
  Client anna = service.client("anna", kAnna);
  Client bert = service.client("bert", kBert);
  anna.call("scene.create", {{"scene", "s"}, {"parts", 4}});
  anna.call("scene.open", {{"scene", "s"}});
  const auto rebalance = [&bert](Json more) {
    more["scene"] = "s";
    return bert.call("rebalance", std::move(more));
  };
  const Received refused = rebalance({{"parts", 5}});
  EXPECT_EQ(refused.code(), "busy");
  EXPECT_NE(refused.message().find("anna"), std::string::npos) << refused.message();
  EXPECT_NE(refused.hint().find("force"), std::string::npos) << refused.hint();
  for (const Json& harmless : {Json{{"parts", 4}}, Json{{"tolerance", 0.5}, {"method", "bands-x"}},
                               Json{{"parts", 5}, {"dry_run", true}}, Json{{"parts", 5}, {"force", true}}})
    EXPECT_EQ(rebalance(harmless).type, FrameType::reply) << harmless;
  EXPECT_EQ(anna.call("rebalance", {{"scene", "s"}, {"parts", 5}}).type, FrameType::reply) << "her own";
  anna.call("scene.close", {{"scene", "s"}});
  EXPECT_EQ(rebalance({{"parts", 6}}).type, FrameType::reply);
}

// So that an answer has room for all scenes, however many clients have them open.
TEST(Session, ScenesAreListedWithAFewOfManyHolders) {
  TestService service;
  std::vector<Client> holders;
  for (int k = 0; k < 12; ++k) {
    holders.push_back(service.client("holder " + std::to_string(10 + k), wire::hex64(100 + static_cast<unsigned>(k))));
    if (k == 0) holders.back().call("scene.create", {{"scene", "s"}});
    EXPECT_EQ(holders.back().call("scene.open", {{"scene", "s"}}).type, FrameType::reply);
  }
  for (const char* command : {"status", "scene.list"}) {
    const Json scene = holders[0].call(command).json["scenes"][0];
    EXPECT_EQ(scene["holders_count"], 12);
    EXPECT_EQ(scene["holders"].size(), 8U);
    EXPECT_EQ(scene["holders"][7], "holder 17");
  }
}

TEST(Session, APushThatWaitsForItsTurnGivesWayToSeatsThatCameMeanwhile) {
  TestService service([](ControlOptions& options) { options.notice_seconds = 0.05; });
  Client anna = service.client("anna", kAnna);
  Client bert = service.client("bert", kBert);
  Client bert_too = service.client("bert", kBert);
  Client cara = service.client("cara", "00000000000000cc");
  anna.call("scene.create", {{"scene", "s"}});
  service.engine().hold();
  bert.request("rebalance", {{"scene", "s"}});
  service.engine().wait_for_orders(1);
  anna.push(0, 5);
  EXPECT_EQ(anna.receive().type, FrameType::notice);  // now it waits
  cara.request("scene.open", {{"scene", "s"}, {"seat", 0}, {"seats", 2}});
  while (bert_too.call("scene.list").json["scenes"][0]["holders_count"] != 1) {
  }
  service.engine().release();
  const Received refused = anna.receive_but_notices();
  EXPECT_EQ(refused.code(), "busy") << refused.json;
  EXPECT_NE(refused.message().find("2 seats"), std::string::npos) << refused.message();
}

TEST(Session, ASeatsOpenThatFailsTakesNoGeneration) {
  TestService service;
  Client cara = service.client("cara");
  cara.call("scene.create", {{"scene", "s"}});
  Json seat{{"scene", "s"}, {"seat", 0}, {"seats", 1}};
  EXPECT_EQ(cara.call("scene.open", seat).code(), "");
  Client again = service.client("cara");
  Client changer = service.client("changer", kBert);
  seat["generation"] = 2;
  service.engine().hold();
  changer.request("rebalance", {{"scene", "s"}});
  service.engine().wait_for_orders(1);  // whoever opens the scene waits for this
  seat["deadline_seconds"] = 0.1;
  EXPECT_EQ(again.call("scene.open", seat).code(), "deadline_exceeded");
  service.engine().release();
  seat.erase("deadline_seconds");
  const Received opened = again.call("scene.open", seat);
  EXPECT_EQ(opened.code(), "") << opened.message();
  const Received refused = cara.call("scene.open", seat);
  EXPECT_EQ(refused.code(), "invalid_argument") << "it held the seat: " << refused.message();
  Client third = service.client("cara");
  EXPECT_EQ(third.call("scene.open", seat).code(), "busy") << "one that was opened is taken";
}

TEST(Session, TheHoldEndsWithTheConnection) {
  TestService service;
  Client bert = service.client("bert", kBert);
  bert.call("scene.create", {{"scene", "s"}});
  {
    Client anna = service.client("anna", kAnna);
    anna.call("scene.open", {{"scene", "s"}});
    EXPECT_EQ(bert.call("scene.drop", {{"scene", "s"}}).code(), "busy");
  }
  std::string code = "busy";
  while (code == "busy") code = bert.call("scene.drop", {{"scene", "s"}}).code();
  EXPECT_EQ(code, "");
}

TEST(Session, OneTooManyIsServedWhatTheOwnerNeedsUntilAPlaceIsFree) {
  TestService service([](ControlOptions& options) { options.sessions_max = 2; });
  Client one = service.client("one");
  {
    Client two = service.client("two");
    Client three = service.client("three");
    EXPECT_EQ(three.call("compare").code(), "busy");
    EXPECT_EQ(three.call("scene.create", {{"scene", "s"}}).code(), "busy");
    three.push(0, 2);
    EXPECT_EQ(three.receive().code(), "busy");
    EXPECT_EQ(three.call("status").json["sessions"], 3);
    EXPECT_EQ(three.call("scene.list").type, FrameType::reply);
    EXPECT_EQ(one.call("compare").json["echo"], "compare");
  }
  Client three = service.client("three");
  while (three.call("status").json["sessions"] != 2) {
  }
  EXPECT_EQ(three.call("compare").json["echo"], "compare");
}

TEST(Session, WhoCameWhenAllWasTakenGivesWayToTheNext) {
  TestService service([](ControlOptions& options) { options.sessions_max = 1; });
  Client one = service.client("one");
  std::vector<Client> late;
  for (int i = 0; i < wire::kSessionsReserved; ++i) late.push_back(service.client("late"));
  EXPECT_EQ(late[0].call("status").type, FrameType::reply);
  Client owner = service.client("owner");
  EXPECT_EQ(late[0].receive().code(), "busy");
  EXPECT_TRUE(late[0].receive().ended);
  EXPECT_EQ(late[1].call("status").type, FrameType::reply);
  EXPECT_EQ(one.call("compare").json["echo"], "compare");
  EXPECT_EQ(owner.call("shutdown").type, FrameType::reply);
}

TEST(Session, WhatHasBegunToArriveIsAnsweredBeforeTheGoodbye) {
  TestService service;
  Client late = service.client("late");
  Client owner = service.client("owner", kBert);
  const std::string whole = frame(FrameType::request, 7, R"({"command":"compare","scene":"s"})");
  late.send_bytes(whole.substr(0, 50));
  for (int k = 0; k < 2; ++k) owner.call("status");  // by then it is read
  EXPECT_EQ(owner.call("shutdown").type, FrameType::reply);
  EXPECT_EQ(owner.receive().type, FrameType::goodbye);
  late.send_bytes(whole.substr(50));
  const Received refused = late.receive();
  EXPECT_EQ(refused.request, 7U);
  EXPECT_EQ(refused.code(), "unavailable");
  EXPECT_EQ(refused.json["failure"]["ending"], true);
  EXPECT_EQ(late.receive().type, FrameType::goodbye);
}

TEST(Session, ASlowReaderLosesItsConnectionOnly) {
  TestService service([](ControlOptions& options) { options.frame_seconds = 0.3; });
  Client slow = service.client("slow");
  slow.request("fetch", {{"scene", "n4194304"}});  // 32 MiB: more than any socket buffer
  Client other = service.client("other");
  while (other.call("status").json["sessions"] != 1) {
  }
  EXPECT_EQ(other.call("fetch", {{"scene", "n1048576"}}).bulk.size(), std::size_t{8} << 20U);
}

TEST(Session, FieldsOfTheInsideDontComeFromOutside) {
  TestService service;
  Client anna = service.client("anna", kAnna);
  anna.call("scene.create", {{"scene", "s"}, {"dims", 2}});
  for (int i = 0; i < 100; ++i) {  // more than may be unfinished: nothing is leaked
    const Json blocks = i % 2 == 0 ? Json(i) : Json::array({Json::object()});
    const Json inside{{"scene", "s"}, {"blocks", blocks}, {"seat", {{"seat", 0}}}, {"seats", 3}};
    EXPECT_EQ(anna.call("rebalance", inside).type, FrameType::reply);
    EXPECT_EQ(service.engine().request(), (Json{{"command", "rebalance"}, {"scene", "s"}}));
  }
  anna.push(0, 4, {{"blocks", 7}, {"seats", 3}});
  EXPECT_EQ(anna.receive_but_notices().json["report"]["step"], 0);
  EXPECT_EQ(service.engine().request()["seats"], 1);
  EXPECT_EQ(service.engine().request()["blocks"],
            Json::array({{{"seat", 0}, {"n", 4}, {"way", "endpoint"}, {"dtype", "<f8"}}}));
  for (const char* command : {"push.begin", "plan", "nonsense", ""})
    EXPECT_EQ(anna.call(command, {{"scene", "s"}, {"blocks", 1}}).code(), "unsupported") << command;
}

// A request of `bytes` that takes long to parse: many small values, or one long text.
std::string large_request(std::uint64_t number, std::size_t bytes, bool numbers) {
  std::string text = R"({"command":"scene.create","scene":"s","part_sizes":)";
  if (!numbers) return frame(FrameType::request, number, text + '"' + std::string(bytes, 'a') + "\"}");
  text += "[1";
  while (text.size() < bytes) text += ",1";
  return frame(FrameType::request, number, text + "]}");
}

TEST(Session, LargeRequestsHoldUpNobodyElse) {
  constexpr int kTries = 10;  // on a busy machine all may be parsed before the other comes
  bool before_them = false;
  for (int i = 0; i < kTries && !before_them; ++i) {
    TestService service;
    Client other = service.client("other", kBert);
    std::vector<Client> large;
    for (int k = 0; k < 6; ++k) large.push_back(service.client("large", kAnna));  // more than there are places
    const std::string request = large_request(9, std::size_t{1} << 20U, true);
    for (Client& one : large) one.send_bytes(request);
    EXPECT_EQ(other.call("status").type, FrameType::reply);
    before_them = service.engine().executed().size() < large.size();
    for (Client& one : large) EXPECT_EQ(one.receive_but_notices().request, 9U);
  }
  EXPECT_TRUE(before_them) << "they were parsed first";
}

TEST(Session, ALargeRequestThatDoesNotComeFreesItsPlace) {
  TestService service([](ControlOptions& options) { options.frame_seconds = 0.3; });
  std::vector<Client> silent;
  for (int i = 0; i < 6; ++i) {  // more than there are places
    silent.push_back(service.client("silent", kAnna));
    silent.back().send_bytes(large_request(9, std::size_t{4} << 20U, false).substr(0, 100));
  }
  Client other = service.client("other", kBert);
  other.send_bytes(large_request(9, std::size_t{1} << 17U, false));
  EXPECT_EQ(other.receive_but_notices().json["scene"], "s");
  for (Client& one : silent) EXPECT_EQ(last_failure(one), "deadline_exceeded");
}

TEST(Session, WhoSendsALargeRequestSlowlyHoldsUpOnlyLargerOnes) {
  TestService service([](ControlOptions& options) { options.frame_seconds = options.notice_seconds = 1000; });
  std::vector<Client> slow;
  for (int i = 0; i < 6; ++i) {  // more than there are places
    for (const std::size_t bytes : {std::size_t{4} << 20U, std::size_t{1} << 17U}) {
      slow.push_back(service.client("slow", kAnna));
      slow.back().send_bytes(large_request(9, bytes, false).substr(0, 100));
    }
  }
  Client other = service.client("other", kBert);
  other.send_bytes(large_request(9, std::size_t{3} << 16U, false));
  EXPECT_EQ(other.receive_but_notices().json["scene"], "s");
}

TEST(Session, ManyValuesAreRefused) {
  TestService service;
  Client client = service.client("c", kAnna);
  std::thread sender([&] { client.send_bytes(large_request(9, std::size_t{3} << 20U, true)); });
  EXPECT_EQ(last_failure(client), "protocol_error");
  sender.join();
  expect_alive(service);
}

TEST(Session, ShutdownIsAnsweredThenEveryoneGetsGoodbye) {
  TestService service;
  Client anna = service.client("anna", kAnna);
  Client bert = service.client("bert", kBert);
  EXPECT_EQ(anna.call("shutdown").type, FrameType::reply);
  EXPECT_EQ(anna.receive().type, FrameType::goodbye);
  EXPECT_TRUE(anna.receive().ended);
  EXPECT_EQ(bert.receive().type, FrameType::goodbye);
  EXPECT_TRUE(bert.receive().ended);
  EXPECT_EQ(service.engine().executed(), std::vector<std::string>{"shutdown"});
  service.control().finish(5);
}

TEST(Session, WhatWasOrderedIsAnsweredBeforeTheEnd) {
  TestService service;
  Client anna = service.client("anna", kAnna);
  Client bert = service.client("bert", kBert);
  service.engine().hold();
  anna.request("compare");
  service.engine().wait_for_orders(1);
  service.control().shut_down("test");
  service.engine().wait_for_orders(2);
  EXPECT_EQ(bert.call("compare").code(), "unavailable");
  service.engine().release();
  EXPECT_EQ(anna.receive_but_notices().json["echo"], "compare");
  EXPECT_EQ(anna.receive().type, FrameType::goodbye);
}

}  // namespace
}  // namespace rcb::net::testing
