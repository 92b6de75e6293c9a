// Client::history: pages put together, a history that grows or vanishes meanwhile, answers that make no sense.
#include <gtest/gtest.h>

#include "client/lib/client.hpp"
#include "tests/client/lib/fake_service.hpp"

namespace rcb::client {
namespace {

using protocol::Json;

// A service with one scene's history, of which it gives at most `page` reports at once.
class Historian {
 public:
  std::uint64_t total = 10;
  std::uint64_t page = 3;
  std::uint64_t lost_below = 0;           // reports that are lost
  std::function<void(int asked)> before;  // of each request
  std::vector<Json> requests;

  FakeService::Script script() {
    return [this](Peer& peer, int) {
      if (!peer.greet(1)) return;
      while (auto frame = peer.receive()) {
        if (frame->type == protocol::FrameType::goodbye) return;
        requests.push_back(frame->json);
        if (before) before(static_cast<int>(requests.size()));
        peer.reply(*frame, answer(frame->json));
      }
    };
  }

 private:
  Json answer(const Json& request) const {
    const std::uint64_t from = request.contains("last") ? total - std::min(total, request["last"].get<std::uint64_t>())
                                                        : std::min(total, request.value("from", std::uint64_t{0}));
    const std::uint64_t end = from + std::min({page, request.value("count", total), total - from});
    Json reports = Json::array();
    for (std::uint64_t k = std::max(from, std::min(lost_below, end)); k < end; ++k)
      reports.push_back({{"scene", "jet"}, {"step", 2 * k}, {"parts", 8}, {"reason", ""}, {"extra", k}});
    Json json{{"history", reports},
              {"from", from},
              {"next", end < total ? Json(end) : Json()},
              {"total", total},
              {"lost", end - from - reports.size()}};
    if (json["lost"] != 0) json["loss"] = "the disk is full";
    return json;
  }
};

struct Told {
  Result<HistoryRead> read;
  std::vector<std::int64_t> steps;
};

Told ask(Historian& historian, const HistoryRange& range) {
  FakeService service(historian.script());
  auto client = Client::connect({.endpoint = service.endpoint()});
  EXPECT_TRUE(client.ok());
  std::vector<std::int64_t> steps;
  auto read = client->history("jet", range, [&steps](const StepReport& report) {
    EXPECT_NE(report.json.find("extra"), std::string::npos);  // as the service sent it
    steps.push_back(report.step);
    return Status();
  });
  return {std::move(read), std::move(steps)};
}

std::vector<std::int64_t> steps_of(std::int64_t from, std::int64_t to) {
  std::vector<std::int64_t> steps;
  for (; from < to; ++from) steps.push_back(2 * from);
  return steps;
}

TEST(History, PagesArePutTogether) {
  for (const std::uint64_t page : {1U, 3U, 9U, 10U, 11U}) {
    Historian historian;
    historian.page = page;
    EXPECT_EQ(ask(historian, {}).steps, steps_of(0, 10));
    EXPECT_EQ(ask(historian, {.first = 4}).steps, steps_of(0, 4));
    EXPECT_EQ(ask(historian, {.last = 4}).steps, steps_of(6, 10));
    EXPECT_EQ(ask(historian, {.first = 2, .last = 7}).steps, steps_of(3, 5));
    EXPECT_EQ(ask(historian, {.first = 50, .last = 50}).steps, steps_of(0, 10));
    const Told none = ask(historian, {.first = 0});
    ASSERT_TRUE(none.read.ok());
    EXPECT_EQ(none.read->reports, 0U);
    EXPECT_EQ(ask(historian, {.last = 0}).steps, steps_of(0, 0));
  }
  Historian empty;
  empty.total = 0;
  const Told told = ask(empty, {});
  ASSERT_TRUE(told.read.ok()) << told.read.status().message();
  EXPECT_EQ(told.read->reports, 0U);
}

TEST(History, WhatIsCommittedMeanwhileIsntTold) {
  Historian historian;
  historian.before = [&](int asked) { historian.total += asked > 1 ? 5U : 0U; };
  EXPECT_EQ(ask(historian, {}).steps, steps_of(0, 10));
}

TEST(History, OfASceneThatWasMadeAnewMeanwhileEnds) {
  Historian historian;
  historian.before = [&](int asked) { historian.total = asked > 1 ? 7U : 10U; };
  EXPECT_EQ(ask(historian, {}).read.status().code(), Code::aborted);
}

TEST(History, LostReportsAreCounted) {
  Historian historian;
  historian.lost_below = 4;
  const Told told = ask(historian, {});
  ASSERT_TRUE(told.read.ok()) << told.read.status().message();
  EXPECT_EQ(told.read->lost, 4U);
  EXPECT_EQ(told.read->reports, 6U);
  EXPECT_EQ(told.read->loss, "the disk is full");
  EXPECT_EQ(told.steps, steps_of(4, 10));
}

TEST(History, TheCallersFailureEndsIt) {
  Historian historian;
  FakeService service(historian.script());
  auto client = Client::connect({.endpoint = service.endpoint()});
  int told = 0;
  const auto read = client->history("jet", {}, [&told](const StepReport&) {
    return ++told < 2 ? Status() : Status(Code::io_error, "no more paper");
  });
  EXPECT_EQ(read.status().message(), "no more paper");
  EXPECT_EQ(told, 2);
}

TEST(History, AnswersThatMakeNoSenseAreRefused) {
  for (const Json& answer : {Json{{"history", Json::array()}}, Json{{"history", 5}, {"from", 0}, {"total", 5}},
                             Json{{"history", Json::array()}, {"from", 0}, {"total", 5}, {"next", 0}},
                             Json{{"history", Json::array()}, {"from", 6}, {"total", 5}},
                             Json{{"history", {1}}, {"from", 0}, {"total", 5}}}) {
    FakeService service([&answer](Peer& peer, int) {
      if (!peer.greet(1)) return;
      while (auto frame = peer.receive()) peer.reply(*frame, answer);
    });
    auto client = Client::connect({.endpoint = service.endpoint()});
    const auto read = client->history("jet", {}, [](const StepReport&) { return Status(); });
    EXPECT_EQ(read.status().code(), Code::protocol_error) << answer.dump();
  }
}

}  // namespace
}  // namespace rcb::client
