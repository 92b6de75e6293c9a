// MemberScene on the direct path, against a scripted service and the listeners of its two ranks: when it goes straight
// to the ranks, what it sends there, and what makes it push by ids again.
#include <array>
#include <cstdlib>
#include <memory>
#include <mutex>
#include <vector>

#include <gtest/gtest.h>

#include "client/lib/member.hpp"
#include "tests/client/lib/fake_service.hpp"
#include "tests/client/lib/three_particles.hpp"
#include "tests/client/lib/told_cuts.hpp"

namespace rcb::client {
namespace {

using protocol::array_of;
using protocol::Json;

// The member keeps the only part; the places told are these, of the ids.
std::vector<protocol::Array> news(const std::vector<std::int64_t>& ids, const std::vector<std::int32_t>& ranks,
                                  const std::vector<std::uint64_t>& slots) {
  std::vector<protocol::Array> arrays = ToldCuts(2, 1, 4).arrays;
  arrays.insert(arrays.end(),
                {array_of("place_id", "<i8", ids), array_of("place_rank", "<i4", ranks),
                 array_of("place_slot", "<u8", slots)});
  return arrays;
}

Json plan_of(int version) { return {{"version", version}, {"checksum", "00000000000000ab"}}; }

Json answer_of(int step, Json more = Json::object()) {
  Json json{{"report", {{"scene", "s"}, {"step", step}, {"n", 30}, {"reason", ""}, {"epoch", 4}}},
            {"plan", plan_of(step + 1)},
            {"cuts", ToldCuts(2, 1, 4).json}};
  json.update(more);
  return json;
}

// A service of two ranks. Every connection to a rank is greeted and read to its end.
class TwoRanks {
 public:
  using Script = std::function<void(Peer& peer)>;

  explicit TwoRanks(Script script) : script_(std::move(script)) {
    for (int rank = 0; rank < 2; ++rank)
      ranks_.push_back(std::make_unique<FakeService>([this, rank](Peer& peer, int) {
        peer.send(protocol::FrameType::welcome, 0, Peer::welcome());
        const auto hello = peer.receive();
        if (!hello) return;
        peer.reply(*hello, {{"rank", rank}});
        while (auto frame = peer.receive()) {
          const std::lock_guard lock(mutex_);
          slices_.push_back(std::move(*frame));
        }
      }));
    control_ = std::make_unique<FakeService>([this](Peer& peer, int number) {
      peer.send(protocol::FrameType::welcome, 0, Peer::welcome());
      const auto hello = peer.receive();
      if (!hello) return;
      peer.reply(*hello, {{"session", hello->json["session"]},
                          {"ranks", 2},
                          {"data", {ranks_[0]->endpoint(), ranks_[1]->endpoint()}}});
      const auto open = peer.receive();
      if (!open) return;
      peer.reply(*open,
                 {{"scene", "s"},
                  {"dims", 2},
                  {"step", nullptr},
                  {"membership", {{"member", 2}, {"members", 3}, {"generation", number + 1}, {"follow", true}}}});
      script_(peer);
      while (const auto close = peer.receive()) peer.reply(*close, Json::object());
    });
  }
  // A push by ids: begin and slice.
  static Received by_ids(Peer& peer) {
    auto begin = peer.receive();
    EXPECT_TRUE(peer.receive());
    return begin ? *begin : Received{};
  }
  const std::string& endpoint() const { return control_->endpoint(); }
  std::vector<Received> slices() {
    control_->stop();
    for (const auto& rank : ranks_) rank->stop();
    return slices_;
  }

 private:
  Script script_;
  std::mutex mutex_;
  std::vector<Received> slices_;
  std::vector<std::unique_ptr<FakeService>> ranks_;
  std::unique_ptr<FakeService> control_;
};

std::vector<double> doubles(const Received& frame) {
  EXPECT_EQ(frame.arrays.size(), 2U);
  std::vector<double> values = frame.values<double>("x");
  const std::vector<double> y = frame.values<double>("y");
  values.insert(values.end(), y.begin(), y.end());
  return values;
}

// Pushes the three particles so many times; the statuses.
std::vector<Status> push(const std::string& endpoint, int times, Path path = Path::direct) {
  std::vector<Status> statuses;
  auto client = Client::connect({.endpoint = endpoint, .path = path});
  EXPECT_TRUE(client.ok()) << client.status().message();
  auto scene = MemberScene::open(*client, "s", {.member = 2, .members = 3, .follow = true});
  EXPECT_TRUE(scene.ok()) << scene.status().message();
  for (int k = 0; k < times; ++k) statuses.push_back(scene->step(Positions::axes(kAxes, 3), kIds).status());
  return statuses;
}

TEST(MemberSceneDirect, GoesToTheRanksOnceItKnowsThePlaces) {
  std::vector<Json> begun;
  TwoRanks service([&begun](Peer& peer) {
    auto begin = TwoRanks::by_ids(peer);
    begun.push_back(begin.json);
    peer.reply(begin, answer_of(0), news({3, 7, 900}, {1, 0, 1}, {5, 0, 2}));
    begin = *peer.receive();
    begun.push_back(begin.json);
    peer.reply(begin, answer_of(1), news({900}, {0}, {9}));
    begin = *peer.receive();
    begun.push_back(begin.json);
    peer.reply(begin, answer_of(2), news({}, {}, {}));
  });
  for (const Status& status : push(service.endpoint(), 3)) EXPECT_TRUE(status.ok()) << status.message();
  const auto slices = service.slices();
  ASSERT_EQ(begun.size(), 3U);
  EXPECT_EQ(begun[0]["order"], "id");
  EXPECT_EQ(begun[0]["places"], true);
  EXPECT_EQ(begun[1]["path"], "direct");
  EXPECT_EQ(begun[1]["order"], "plan");
  EXPECT_EQ(begun[1]["ids"], false);
  EXPECT_EQ(begun[1]["places"], true);
  EXPECT_EQ(begun[1]["n"], 3);
  EXPECT_EQ(begun[1]["slices"], 0);
  EXPECT_EQ(begun[1]["plan"], plan_of(1));
  EXPECT_EQ(begun[1]["epoch"], 4);
  EXPECT_EQ(begun[1]["base_step"], 0);
  EXPECT_EQ(begun[1]["counts"], Json({1, 2}));
  EXPECT_EQ(begun[2]["plan"], plan_of(2));
  EXPECT_EQ(begun[2]["counts"], Json({2, 1}));
  ASSERT_EQ(slices.size(), 4U);
  for (const Received& slice : slices) {
    const bool second = slice.json["step"] == 2;
    const bool of_first_rank = slice.json["rank"] == 0;
    EXPECT_EQ(slice.json["attempt"], begun[second ? 2 : 1]["attempt"]);
    EXPECT_EQ(slice.json["first"], 0);
    // Rank 1 has 900 in slot 2 and 3 in slot 5, then 3 alone; 900 goes behind 7.
    const auto expected = second
                              ? (of_first_rank ? std::vector<double>{0.5, 2.5, 10, 12} : std::vector<double>{1.5, 11})
                              : (of_first_rank ? std::vector<double>{0.5, 10} : std::vector<double>{2.5, 1.5, 12, 11});
    EXPECT_EQ(doubles(slice), expected) << slice.json.dump();
  }
}

TEST(MemberSceneDirect, SendsNothingOfWhatHasNotMoved) {
  std::vector<Json> begun;
  TwoRanks service([&begun](Peer& peer) {
    auto begin = TwoRanks::by_ids(peer);  // nobody knows yet where they stood
    begun.push_back(begin.json);
    peer.reply(begin, answer_of(0), news({3, 7, 900}, {1, 0, 1}, {5, 0, 2}));
    begin = *peer.receive();
    begun.push_back(begin.json);
    peer.reply(begin, answer_of(1), news({}, {}, {}));
  });
  {
    auto client = Client::connect({.endpoint = service.endpoint(), .path = Path::direct});
    auto scene = MemberScene::open(*client, "s", {.member = 2, .members = 3, .follow = true});
    for (int k = 0; k < 2; ++k) {
      MemberStepOptions options;
      options.unmoved = true;
      EXPECT_TRUE(scene->step(Positions::axes(kAxes, 3), kIds, options).ok());
    }
  }
  EXPECT_TRUE(service.slices().empty());
  ASSERT_EQ(begun.size(), 2U);
  EXPECT_EQ(begun[0]["moved"], "all");
  EXPECT_EQ(begun[1]["moved"], "none");
  EXPECT_EQ(begun[1]["path"], "direct");
  EXPECT_EQ(begun[1]["counts"], Json({1, 2}));
}

TEST(MemberSceneDirect, PushesByIdsWhereItsKnowledgeIsRefusedOrLacking) {
  for (const Code code : {Code::stale_plan, Code::base_lost}) {
    std::vector<Json> begun;
    TwoRanks service([&](Peer& peer) {
      auto begin = TwoRanks::by_ids(peer);
      peer.reply(begin, answer_of(0), news({3, 7, 900}, {1, 0, 1}, {5, 0, 2}));
      begin = *peer.receive();
      begun.push_back(begin.json);
      peer.fail(begin, {code, "member 0 pushes by ids", ""});
      begin = TwoRanks::by_ids(peer);
      begun.push_back(begin.json);
      // A step that was committed before this try: its places were told to another one.
      peer.reply(begin, answer_of(1, {{"repeated", true}}), news({3, 7, 900}, {1, 0, 1}, {5, 0, 2}));
      begin = TwoRanks::by_ids(peer);
      begun.push_back(begin.json);
      // Somebody else didn't ask for places, so nobody is told any.
      auto arrays = news({}, {}, {});
      arrays.resize(arrays.size() - 3);
      peer.reply(begin, answer_of(2), arrays);
      begin = TwoRanks::by_ids(peer);
      begun.push_back(begin.json);
      peer.reply(begin, answer_of(3), news({3, 7, 901}, {1, 0, 1}, {5, 0, 2}));
      begin = TwoRanks::by_ids(peer);  // 901 was not handed over
      begun.push_back(begin.json);
      peer.reply(begin, answer_of(4), news({}, {}, {}));
    });
    for (const Status& status : push(service.endpoint(), 5)) EXPECT_TRUE(status.ok()) << status.message();
    static_cast<void>(service.slices());
    ASSERT_EQ(begun.size(), 5U);
    EXPECT_EQ(begun[0]["path"], "direct");
    EXPECT_EQ(begun[0]["step"], begun[1]["step"]);
    EXPECT_LT(begun[0]["attempt"], begun[1]["attempt"]);
    for (std::size_t k = 1; k < begun.size(); ++k) {
      EXPECT_EQ(begun[k]["order"], "id") << k;
      EXPECT_EQ(begun[k]["slices"], 1) << k;
      EXPECT_EQ(begun[k]["places"], true) << k;
    }
  }
}

TEST(MemberSceneDirect, AsksForNoPlacesWhereItCannotUseThem) {
  const auto places_asked = [](Path path) {
    Json asked;
    TwoRanks service([&asked](Peer& peer) {
      const auto begin = TwoRanks::by_ids(peer);
      peer.reply(begin, answer_of(0), news({3, 7, 900}, {1, 0, 1}, {5, 0, 2}));
      const auto small = TwoRanks::by_ids(peer);
      asked = {begin.json["places"], small.json["places"]};
      peer.reply(small, answer_of(1), news({}, {}, {}));
    });
    for (const Status& status : push(service.endpoint(), 2, path)) EXPECT_TRUE(status.ok()) << status.message();
    static_cast<void>(service.slices());
    return asked;
  };
  EXPECT_EQ(places_asked(Path::gateway), Json({false, false}));
  EXPECT_EQ(places_asked(Path::automatic), Json({true, false}));  // once it is known that the scene is small
}

TEST(MemberSceneDirect, ABadAnswerIsNamed) {
  TwoRanks service([](Peer& peer) {
    peer.reply(TwoRanks::by_ids(peer), answer_of(0), news({3, 7, 900}, {1, 0, 2}, {5, 0, 2}));  // of two ranks
    peer.reply(TwoRanks::by_ids(peer), answer_of(1), news({3, 7, 900}, {1, 0}, {5, 0, 2}));
    peer.reply(TwoRanks::by_ids(peer), answer_of(2), news({3, 7, 900}, {1, 0, 1}, {5, 0, 30}));  // of 30 particles
  });
  for (const Status& status : push(service.endpoint(), 3)) {
    EXPECT_EQ(status.code(), Code::protocol_error);
    EXPECT_NE(status.message().find("places"), std::string::npos) << status.message();
  }
  static_cast<void>(service.slices());
}

}  // namespace
}  // namespace rcb::client
