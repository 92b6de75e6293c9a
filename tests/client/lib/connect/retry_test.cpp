#include "client/lib/connect/retry.hpp"

#include <random>

#include <gtest/gtest.h>

#include "client/lib/client.hpp"
#include "tests/client/lib/fake_service.hpp"

namespace rcb::client {
namespace {

TEST(Retry, EndsAtTheDeadlineAndTellsWhatItWaitsFor) {
  std::vector<std::string> told;
  Retry retry(2);
  int tries = 0;
  while (retry.wait("the service at E, which has gone", [&told](const std::string& text) { told.push_back(text); }))
    ++tries;
  EXPECT_GT(tries, 1);  // the pauses are random
  EXPECT_EQ(retry.failures(), tries + 1);
  ASSERT_FALSE(told.empty());
  EXPECT_TRUE(told[0].starts_with("waiting for the service at E, which has gone; tried ")) << told[0];
  EXPECT_TRUE(retry.end_of_waiting());
  EXPECT_FALSE(retry.end_of_waiting());
}

// A service whose connections end after the hello, but for every `patience`-th.
FakeService cutting(int patience) {
  return FakeService([patience](Peer& peer, int number) {
    if (!peer.greet(1)) return;
    auto request = peer.receive();
    if (!request || number % patience != patience - 1) return;
    peer.reply(*request, {{"number", number}});
    while (peer.receive()) continue;
  });
}

TEST(Outlive, ACallSurvivesAnyNumberOfCuts) {
  FakeService service = cutting(8);
  auto client = Client::connect({.endpoint = service.endpoint()});
  ASSERT_TRUE(client.ok());
  const auto reply = client->call("status", "{}", 30);
  ASSERT_TRUE(reply.ok()) << reply.status().message();
  EXPECT_NE(reply->json.find("\"number\":7"), std::string::npos) << reply->json;
}

TEST(Outlive, ACallThatDoesNotTriesOneNewConnection) {
  FakeService service = cutting(3);
  auto client = Client::connect({.endpoint = service.endpoint(), .outlive = false});
  ASSERT_TRUE(client.ok());
  EXPECT_EQ(client->call("status", "{}", 30).status().code(), Code::unavailable);
}

TEST(Outlive, TheDeadlineEndsItAndTheHintIsTrue) {
  for (const bool goodbye : {false, true}) {
    auto service = std::make_unique<FakeService>([goodbye](Peer& peer, int) {
      if (!peer.greet(1) || !peer.receive()) return;
      if (goodbye) peer.send(protocol::FrameType::goodbye, 0, protocol::Json::object());
    });
    auto client = Client::connect({.endpoint = service->endpoint()});
    ASSERT_TRUE(client.ok());
    std::thread end([&service] { service.reset(); });
    const Status status = client->call("status", "{}", 0.3).status();
    end.join();
    EXPECT_EQ(status.code(), Code::unavailable);
    EXPECT_NE(status.message().find(goodbye ? "was stopped; tried " : "has gone; tried "), std::string::npos)
        << status.message();
    EXPECT_EQ(status.hint().find("start it again") != std::string::npos, goodbye) << status.hint();
  }
}

// At once, since nobody starts it again by itself; on standard error, where the caller takes no notices.
TEST(Outlive, AServiceThatWasStoppedIsToldOf) {
  for (const bool while_asked : {false, true}) {
    auto service = std::make_unique<FakeService>([while_asked](Peer& peer, int) {
      if (!peer.greet(1) || (while_asked && !peer.receive())) return;
      peer.send(protocol::FrameType::goodbye, 0, protocol::Json::object());
    });
    ::testing::internal::CaptureStderr();
    auto client = Client::connect({.endpoint = service->endpoint(), .name = "jet"});
    ASSERT_TRUE(client.ok());
    if (!while_asked) service.reset();
    std::thread end([&service] { service.reset(); });
    EXPECT_EQ(client->call("status", "{}", 0.3).status().code(), Code::unavailable);
    end.join();
    const std::string told = ::testing::internal::GetCapturedStderr();
    EXPECT_TRUE(told.starts_with("jet: the service at unix:")) << told;
    EXPECT_NE(told.find(" was stopped; "), std::string::npos) << told;
    EXPECT_EQ(told.find('\n'), told.size() - 1) << "once: " << told;
  }
}

// It can't do this, and says why. The connection stands.
TEST(Outlive, AServiceThatAnswersUnavailableIsNotGone) {
  std::vector<std::string> seen;
  FakeService service([&seen](Peer& peer, int number) {
    if (!peer.greet(1)) return;
    while (const auto request = peer.receive()) {
      if (request->type == protocol::FrameType::goodbye) return;
      const std::string command = request->json["command"];
      seen.push_back(command + " " + std::to_string(number));
      if (command == "status")
        peer.reply(*request, protocol::Json::object());
      else
        peer.fail(*request, {Code::unavailable, "the service can start no thread", "raise the limit"});
    }
  });
  {
    auto client = Client::connect({.endpoint = service.endpoint()});
    ASSERT_TRUE(client.ok());
    for (const char* command : {"load", "write_parts"}) {
      const Status status = client->call(command, "{}", 30).status();
      EXPECT_EQ(status.code(), Code::unavailable);
      EXPECT_EQ(status.message(), "the service can start no thread");
      EXPECT_EQ(status.hint(), "raise the limit");
    }
    EXPECT_TRUE(client->call("status", "{}", 30).ok());
  }
  service.stop();
  EXPECT_EQ(seen, (std::vector<std::string>{"load 0", "write_parts 0", "status 0"}));
}

// Unlike the one above.
TEST(Outlive, AServiceThatIsAboutToEndIsWaitedFor) {
  FakeService service([](Peer& peer, int number) {
    if (!peer.greet(1)) return;
    while (const auto request = peer.receive()) {
      if (number > 0)
        peer.reply(*request, {{"number", number}});
      else
        peer.send(protocol::FrameType::failure, request->request,
                  {{"failure", {{"code", "unavailable"}, {"message", "the end"}, {"ending", true}}}});
    }
  });
  auto client = Client::connect({.endpoint = service.endpoint()});
  ASSERT_TRUE(client.ok());
  const auto reply = client->call("load", "{}", 30);
  ASSERT_TRUE(reply.ok()) << reply.status().message();
  EXPECT_NE(reply->json.find("\"number\":1"), std::string::npos) << reply->json;
}

// Perhaps it is held by a solver whose machine has vanished, which the service hasn't noticed yet.
TEST(Outlive, ASceneThatIsHeldIsWaitedFor) {
  for (const bool outlive : {true, false}) {
    int refused = 0;
    FakeService service([&refused](Peer& peer, int) {
      if (!peer.greet(1)) return;
      while (const auto request = peer.receive()) {
        if (request->type == protocol::FrameType::goodbye) return;
        if (refused++ % 3 < 2)
          peer.fail(*request, {Code::busy, "scene 's' is held open by jet", "try again when it is closed"});
        else
          peer.reply(*request, protocol::Json::object());
      }
    });
    {
      auto client = Client::connect({.endpoint = service.endpoint(), .outlive = outlive});
      ASSERT_TRUE(client.ok());
      const Code expected = outlive ? Code::ok : Code::busy;
      EXPECT_EQ(client->create_scene("s", {.replace = true}).code(), expected);
      EXPECT_EQ(client->drop_scene("s").code(), expected);
    }
    service.stop();
    EXPECT_EQ(refused, outlive ? 6 : 2);
  }
}

// Its scenes outlive a service: what it may have done isn't done again, unless that makes no difference.
TEST(Outlive, ASceneIsCreatedAgainOnlyInThePlaceOfAnother) {
  std::vector<std::string> seen;
  FakeService service([&seen](Peer& peer, int number) {
    if (!peer.greet(1)) return;
    while (const auto request = peer.receive()) {
      if (request->type == protocol::FrameType::goodbye) return;
      seen.push_back(request->json["command"]);
      if (number < 2) return;
      peer.reply(*request, protocol::Json::object());
    }
  });
  {
    auto client = Client::connect({.endpoint = service.endpoint()});
    ASSERT_TRUE(client.ok());
    EXPECT_EQ(client->create_scene("s", {.parts = 2}).code(), Code::unavailable);
    EXPECT_TRUE(client->create_scene("s", {.parts = 2, .replace = true}).ok());
  }
  service.stop();
  EXPECT_EQ(seen, (std::vector<std::string>{"scene.create", "scene.create", "scene.create"}));
}

TEST(Outlive, AShutdownIsNotRepeated) {
  int shutdowns = 0;
  FakeService service([&shutdowns](Peer& peer, int) {
    if (peer.greet(1) && peer.receive()) ++shutdowns;
  });
  {
    auto client = Client::connect({.endpoint = service.endpoint()});
    ASSERT_TRUE(client.ok());
    EXPECT_EQ(client->shutdown_service().code(), Code::unavailable);
  }
  service.stop();
  EXPECT_EQ(shutdowns, 1);
}

}  // namespace
}  // namespace rcb::client
