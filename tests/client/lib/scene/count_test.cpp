// Steps that are counts, with a service that is late, gone, has other cuts, or wants the positions.
#include <array>
#include <atomic>
#include <map>
#include <numeric>
#include <random>

#include <gtest/gtest.h>

#include "client/lib/client.hpp"
#include "common/base/exact_scale.hpp"
#include "common/base/random.hpp"
#include "tests/client/lib/fake_scene.hpp"

namespace rcb::client {
namespace {

constexpr std::int32_t kPartsCounted = 5;
constexpr std::size_t kRowsCounted = 400;

// The part of a particle at a step; one in ten changes it from step to step.
std::int32_t part_counted(std::int64_t id, std::int64_t step) {
  const std::uint64_t mixed = mix64(static_cast<std::uint64_t>(id));
  return static_cast<std::int32_t>((mixed + (mixed / 16 + static_cast<std::uint64_t>(step)) / 10) % kPartsCounted);
}
double x_counted(std::int64_t id, std::size_t axis, std::int64_t step) {
  if (axis == 0) return part_counted(id, step) + 0.5;  // FakeScene's cuts lie at 1, 2, ...
  return static_cast<double>(id) + 0.001 * static_cast<double>(step);
}

struct Counting {
  FakeScene fake{2, kPartsCounted, 3};
  std::unique_ptr<FakeService> service;
  std::optional<Client> client;
  std::optional<Scene> scene;
  std::vector<double> xy = std::vector<double>(2 * kRowsCounted);

  Counting() {
    fake.options = {{"positions", "when-needed"}, {"incarnation", "00000000000000ab"}};
    fake.position = x_counted;
    service = std::make_unique<FakeService>([this](Peer& peer, int) { fake.serve(peer); });
    auto connected = Client::connect({.endpoint = service->endpoint()});
    EXPECT_TRUE(connected.ok()) << connected.status().message();
    client.emplace(std::move(*connected));
    auto opened = client->open_scene("s");
    EXPECT_TRUE(opened.ok()) << opened.status().message();
    scene.emplace(std::move(*opened));
  }
  ~Counting() { end(); }
  // What the service wrote may be read after this.
  void end() {
    scene.reset();
    client.reset();
    service->stop();
  }
  Positions at(std::int64_t step) {
    for (std::size_t i = 0; i < kRowsCounted; ++i)
      for (std::size_t a = 0; a < 2; ++a) xy[2 * i + a] = x_counted(static_cast<std::int64_t>(i), a, step);
    return Positions::rows(xy.data(), kRowsCounted, 2);
  }
  Result<StepResult> step(std::int64_t number, const StepOptions& options = {}) {
    return scene->step(at(number), options);
  }
};

std::uint64_t changed_between(std::int64_t before, std::int64_t now) {
  std::uint64_t changed = 0;
  for (std::size_t i = 0; i < kRowsCounted; ++i)
    changed +=
        part_counted(static_cast<std::int64_t>(i), before) != part_counted(static_cast<std::int64_t>(i), now) ? 1U : 0U;
  return changed;
}

// Against the formula.
void expect_count(const wire::CountRecord& record, std::int64_t step, std::optional<std::uint64_t> drifted) {
  EXPECT_EQ(record.step, step);
  EXPECT_EQ(record.n, kRowsCounted);
  EXPECT_EQ(record.incarnation, 0xabU);
  EXPECT_EQ(record.drifted, drifted);
  std::map<std::int32_t, std::uint64_t> expected, told;
  std::uint64_t id_sum = 0;
  for (std::size_t i = 0; i < kRowsCounted; ++i) {
    ++expected[part_counted(static_cast<std::int64_t>(i), step)];
    id_sum += mix64(i);
  }
  EXPECT_EQ(record.id_sum, id_sum);
  for (std::size_t k = 0; k < record.parts.size(); ++k) told[record.parts[k]] = record.counts[k];
  EXPECT_EQ(told, expected);
}

TEST(CountedStep, TravelsInPlaceOfPositions) {
  Counting of;
  ASSERT_TRUE(of.step(0).ok());
  for (std::int64_t step = 1; step < 4; ++step) {
    const auto done = of.step(step, {.want_parts = true, .want_changes = true});
    ASSERT_TRUE(done.ok()) << done.status().message();
    EXPECT_FALSE(done->report.sent);
    EXPECT_EQ(done->report.drifted, changed_between(step - 1, step));
    for (std::size_t i = 0; i < kRowsCounted; ++i)
      EXPECT_EQ(done->parts[i], part_counted(static_cast<std::int64_t>(i), step));
    EXPECT_EQ(done->changes.size(), step == 1 ? kRowsCounted : changed_between(step - 1, step));
  }
  of.end();
  ASSERT_EQ(of.fake.counted.size(), 3U);
  for (std::int64_t step = 1; step < 4; ++step)
    expect_count(of.fake.counted[static_cast<std::size_t>(step) - 1], step, changed_between(step - 1, step));
  EXPECT_EQ(of.fake.commits, 1);
}

TEST(CountedStep, IsRepeatedWhereTheConnectionIsLost) {
  for (const FakeScene::Fault fault : {FakeScene::Fault::close_before_commit, FakeScene::Fault::close_after_commit}) {
    Counting of;
    of.fake.count_fault = [fault](int n) { return n == 1 ? fault : FakeScene::Fault::none; };
    for (std::int64_t step = 0; step < 4; ++step) {
      const auto done = of.step(step, {.want_changes = true});
      ASSERT_TRUE(done.ok()) << done.status().message();
      EXPECT_EQ(done->report.step, step);
      if (step > 1) {
        EXPECT_EQ(done->changes.size(), changed_between(step - 1, step));
      }
    }
    of.end();
    ASSERT_EQ(of.fake.counted.size(), 4U);
    expect_count(of.fake.counted[1], 2, changed_between(1, 2));
    expect_count(of.fake.counted[2], 2, changed_between(1, 2));
    expect_count(of.fake.counted.back(), 3, changed_between(2, 3));
  }
}

// The same once more is answered; something else is the step after that one.
TEST(CountedStep, ThatWasNotAnsweredIsSettled) {
  for (const bool same : {true, false}) {
    Counting of;
    of.fake.count_fault = [](int n) { return n == 0 ? FakeScene::Fault::late_after_commit : FakeScene::Fault::none; };
    ASSERT_TRUE(of.step(0).ok());
    EXPECT_EQ(of.step(1).status().code(), Code::deadline_exceeded);
    const auto done = of.step(same ? 1 : 2);
    ASSERT_TRUE(done.ok()) << done.status().message();
    EXPECT_EQ(done->report.step, same ? 1 : 2);
    EXPECT_EQ(done->report.drifted, same ? std::optional(changed_between(0, 1)) : std::nullopt);
    const auto next = of.step(3);
    ASSERT_TRUE(next.ok()) << next.status().message();
    EXPECT_EQ(next->report.drifted, changed_between(same ? 1 : 2, 3));
  }
}

TEST(CountedStep, CountsAnewByOtherCuts) {
  Counting of;
  of.fake.verdict = [&of](int n) {
    if (n != 1) return protocol::Json();
    of.fake.epoch += 2;  // by somebody else
    return protocol::Json{{"again", "cuts"}};
  };
  for (std::int64_t step = 0; step < 3; ++step) ASSERT_TRUE(of.step(step).ok());
  EXPECT_EQ(of.scene->cuts()->epoch(), 3U);
  of.end();
  ASSERT_EQ(of.fake.counted.size(), 3U);
  EXPECT_EQ(of.fake.counted[1].epoch, 1U);
  EXPECT_EQ(of.fake.counted[2].epoch, 3U);
  expect_count(of.fake.counted[2], 2, std::nullopt);
}

TEST(CountedStep, PushesWherePositionsAreWanted) {
  Counting of;
  of.fake.verdict = [](int n) { return n == 1 ? protocol::Json{{"send", "new cuts are due"}} : protocol::Json(); };
  std::atomic<int> begun{0};
  of.fake.fault = [&begun](int) {
    return ++begun == 2 ? FakeScene::Fault::close_before_commit : FakeScene::Fault::none;
  };
  for (std::int64_t step = 0; step < 4; ++step) {
    const auto done = of.step(step);
    ASSERT_TRUE(done.ok()) << done.status().message();
    EXPECT_EQ(done->report.sent, step == 0);  // the connection was lost with a push: the repeated count is taken
    EXPECT_EQ(done->report.step, step);
  }
  of.end();
  ASSERT_EQ(of.fake.counted.size(), 4U);
  expect_count(of.fake.counted[2], 2, changed_between(1, 2));
}

// As a run's last step is: nothing is counted for it.
TEST(CountedStep, IsPushedAtOnceWhereTheCallerSaysSo) {
  Counting of;
  for (std::int64_t step = 0; step < 4; ++step) {
    const auto done = of.step(step, {.send = step == 2});
    ASSERT_TRUE(done.ok()) << done.status().message();
    EXPECT_EQ(done->report.sent, step == 0 || step == 2);
  }
  of.end();
  ASSERT_EQ(of.fake.begun.size(), 2U);
  EXPECT_EQ(of.fake.begun[1]["drifted"], changed_between(1, 2));
  ASSERT_EQ(of.fake.counted.size(), 2U);
  expect_count(of.fake.counted[0], 1, changed_between(0, 1));
  expect_count(of.fake.counted[1], 3, changed_between(2, 3));
}

// In another order than before the parts before are unknown. What comes or goes is counted, but where no ids tell
// which.
TEST(CountedStep, OfOtherRowsIsCountedAnew) {
  Counting of;
  std::vector<std::int64_t> ids(kRowsCounted);
  std::iota(ids.begin(), ids.end(), 0);
  const auto at = [&](std::int64_t step) {
    for (std::size_t i = 0; i < ids.size(); ++i)
      for (std::size_t a = 0; a < 2; ++a) of.xy[2 * i + a] = x_counted(ids[i], a, step);
    return Positions::rows(of.xy.data(), ids.size(), 2);
  };
  ASSERT_TRUE(of.scene->step(at(0), {.ids = ids}).ok());
  ASSERT_TRUE(of.scene->step(at(1), {.ids = ids}).ok());
  std::rotate(ids.begin(), ids.begin() + 7, ids.end());
  ASSERT_TRUE(of.scene->step(at(2), {.ids = ids}).ok());
  ids.pop_back();
  ids.back() = 9000;
  const auto flowed = of.scene->step(at(3), {.ids = ids, .inserted = 1, .removed = 2});
  ASSERT_TRUE(flowed.ok()) << flowed.status().message();
  EXPECT_FALSE(flowed->report.sent);
  ids.push_back(9001);
  EXPECT_FALSE(of.scene->step(at(4), {.inserted = 1}).ok());
  of.end();
  ASSERT_EQ(of.fake.counted.size(), 3U);
  expect_count(of.fake.counted[0], 1, changed_between(0, 1));
  expect_count(of.fake.counted[1], 2, std::nullopt);
  EXPECT_FALSE(of.fake.counted[0].flows() || of.fake.counted[1].flows());
  const wire::CountRecord& last = of.fake.counted[2];
  EXPECT_EQ(last.n, kRowsCounted - 1);
  EXPECT_EQ(last.inserted, 1U);
  EXPECT_EQ(last.removed, 2U);
  EXPECT_FALSE(last.drifted.has_value());
  std::uint64_t sum = 0;
  for (std::size_t i = 0; i + 1 < ids.size(); ++i) sum += mix64(static_cast<std::uint64_t>(ids[i]));
  EXPECT_EQ(last.id_sum, sum);
  EXPECT_EQ(of.fake.commits, 1);
  EXPECT_EQ(of.fake.begun.size(), 2U);
}

TEST(CountedStep, WeightsAreSummedInTheScaleThatIsDue) {
  Counting of;
  of.fake.verdict = [](int n) { return n == 2 ? protocol::Json{{"again", "scale"}, {"scale", 60}} : protocol::Json(); };
  std::vector<double> weights(kRowsCounted);
  for (std::size_t i = 0; i < kRowsCounted; ++i) weights[i] = 1 + 0.5 * static_cast<double>(i % 7);
  ASSERT_TRUE(of.step(0, {.weights = weights}).ok());
  ASSERT_TRUE(of.step(1).ok());  // they are kept
  weights[17] = 1e9;
  ASSERT_TRUE(of.step(2, {.weights = weights}).ok());
  ASSERT_TRUE(of.step(3).ok());
  of.end();
  ASSERT_EQ(of.fake.counted.size(), 4U);
  const auto check = [&](std::size_t k, std::int64_t step, int scale) {
    const wire::CountRecord& record = of.fake.counted[k];
    ASSERT_TRUE(record.weights.has_value());
    EXPECT_EQ(record.weights->scale, scale);
    EXPECT_EQ(record.weights->least, 1);
    EXPECT_EQ(record.weights->greatest, k == 0 ? 4 : 1e9);
    weights[17] = k == 0 ? 2.5 : 1e9;
    std::array<u128, kPartsCounted> loads{};
    for (std::size_t i = 0; i < kRowsCounted; ++i)
      loads[static_cast<std::size_t>(part_counted(static_cast<std::int64_t>(i), step))] +=
          ExactScale(scale)(weights[i]);
    for (std::size_t p = 0; p < record.parts.size(); ++p)
      EXPECT_TRUE(record.weights->loads[p] == loads[static_cast<std::size_t>(record.parts[p])]);
  };
  check(0, 1, ExactScale(4, kRowsCounted).exponent());
  check(1, 2, ExactScale(1e9, kRowsCounted).exponent());
  check(2, 3, ExactScale(1e9, kRowsCounted).exponent());
  check(3, 3, 60);
}

TEST(CountedStep, AWrongValueIsRefusedBeforeAnythingIsSent) {
  Counting of;
  ASSERT_TRUE(of.step(0).ok());
  const Positions positions = of.at(1);
  of.xy[2 * 31 + 1] = std::numeric_limits<double>::quiet_NaN();
  const auto refused = of.scene->step(positions);
  EXPECT_EQ(refused.status().code(), Code::not_finite);
  EXPECT_EQ(refused.status().message(), "particle 31 (index, from 0): y is nan");
  std::vector<std::int64_t> ids(kRowsCounted);
  std::iota(ids.begin(), ids.end(), 0);
  ids[7] = -3;
  const auto negative = of.step(1, {.ids = ids});
  EXPECT_EQ(negative.status().code(), Code::invalid_argument);
  EXPECT_EQ(negative.status().message(), "particle -3: id is -3");
  ASSERT_TRUE(of.step(1).ok());
  of.end();
  EXPECT_EQ(of.fake.counted.size(), 1U);
}

}  // namespace
}  // namespace rcb::client
