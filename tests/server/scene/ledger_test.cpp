// What a ledger remembers and forgets, by hand; equivalence_test.cpp tries random scenes.
#include "server/scene/ledger.hpp"

#include <cmath>
#include <limits>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "server/scene/policy.hpp"
#include "tests/server/scene/counting.hpp"

namespace rcb::testing {
namespace {

using scene::Created;
using scene::Ledgers;

enum class Search { none, adopted, wasted };

// A scene that was pushed as step 0, with so many particles in each part.
struct Pushed {
  explicit Pushed(std::vector<std::uint64_t> counts, scene::SceneOptions options = {}, bool with_weights = false)
      : weighted(with_weights) {
    options.parts = static_cast<int>(counts.size());
    options.positions = scene::Travel::when_needed;
    ledgers.take({"jet", Created{options, {}}}, 5);
    ledger = ledgers.find("jet");
    push(0, std::move(counts), Search::adopted);
  }
  scene::Held held(std::vector<std::uint64_t> counts) const {
    scene::Held held;
    held.weights = weighted;
    held.epoch = 1;
    for (const std::uint64_t count : counts) held.n += count;
    held.loads = std::make_shared<const partition::LoadSummary>(partition::summarise_counts(std::move(counts), {}));
    return held;
  }
  void push(std::int64_t step, std::vector<std::uint64_t> counts, Search search = Search::none) {
    scene::Stepped stepped;
    stepped.held = held(std::move(counts));
    stepped.sessions = {scene::session_key("run")};
    stepped.step_seconds = seconds;
    stepped.wasted = search == Search::wasted;
    scene::StepReport& report = stepped.report;
    report.step = step;
    report.repartitioned = search == Search::adopted;
    report.seconds.search = search_seconds;
    report.seconds.migrate = 0.125;
    report.error_before = report.error = stepped.held.loads->error;
    report.imbalance = stepped.held.loads->imbalance;
    ledger->take(std::move(stepped));
  }
  scene::CountVerdict count(std::int64_t step, const std::vector<std::uint64_t>& counts) {
    scene::CountRecord record{{step, 5, 1, 0}, "run"};
    record.step_seconds = seconds;
    record.sessions = {scene::session_key("run")};
    for (std::size_t p = 0; p < counts.size(); ++p) {
      record.n += counts[p];
      record.parts.push_back(static_cast<std::int32_t>(p));
      record.counts.push_back(counts[p]);
    }
    if (weighted) record.weights = scene::WeightCount{0, 1, 1, 0, std::vector<u128>(counts.size())};
    return ledger->count(record);
  }

  bool weighted = false;
  Ledgers ledgers{{.keep_reports = 2000}};
  scene::Ledger* ledger = nullptr;
  std::optional<double> seconds;
  double search_seconds = 0.125;
};

scene::SceneOptions by_cost() {
  scene::SceneOptions options;
  options.policy = scene::Policy::cost;
  return options;
}

TEST(Ledger, ChargesAStepForTheImbalanceBeforeItOnce) {
  Pushed scene({4, 4}, by_cost());
  scene.seconds = 1;
  const auto lost = [&scene] { return scene.ledger->terms(0.0).lost_seconds; };
  EXPECT_EQ(in_words(scene.count(1, {5, 3})), "committed after 0");
  EXPECT_EQ(lost(), 0);  // it was computed under 4 and 4
  EXPECT_EQ(in_words(scene.count(1, {5, 3})), "refused stale_step");
  EXPECT_EQ(lost(), 0);
  scene.seconds = 0.5;
  EXPECT_EQ(in_words(scene.count(2, {5, 3})), "committed after 1");
  EXPECT_DOUBLE_EQ(lost(), 0.1);  // of 0.5 s, with an imbalance of 1.25
  scene.seconds = 0.1;
  EXPECT_EQ(in_words(scene.count(3, {6, 2})), "committed after 2");
  EXPECT_DOUBLE_EQ(lost(), 0.12);
  scene.seconds = 0.3;
  for (int again = 0; again < 3; ++again)
    EXPECT_EQ(in_words(scene.count(4, {6, 2})),
              "send: error 0.5; imbalance has cost 0.22 s since step 0 and would cost 0.1 s in this one, "
              "a repartition costs 0.25 s");
  EXPECT_DOUBLE_EQ(lost(), 0.12);
  scene.push(4, {6, 2});
  EXPECT_DOUBLE_EQ(lost(), 0.12 + 0.3 * (1 - 1 / 1.5));
  scene.push(5, {4, 4}, Search::adopted);
  EXPECT_EQ(lost(), 0);
  EXPECT_EQ(scene.ledger->terms(0.0).since, 5);
}

TEST(Ledger, BeginsItsAccountAnewWithNewCutsOrAfterAVainSearch) {
  Pushed scene({4, 4}, by_cost());
  scene.seconds = 1;
  const auto terms = [&scene] { return scene.ledger->terms(0.0); };
  EXPECT_EQ(terms().repartition_seconds, 0.25);  // of the first partition, as long as there is no other
  scene.count(1, {5, 3});
  scene.push(2, {5, 3}, Search::wasted);
  EXPECT_EQ(terms().error_when_not_adopted, 0.25);
  EXPECT_EQ(terms().lost_seconds, 0);
  EXPECT_EQ(terms().since, std::nullopt);
  EXPECT_EQ(in_words(scene.count(3, {6, 2})), "committed after 2");
  EXPECT_EQ(terms().lost_seconds, 0);  // 1.25 is the best that can be had
  scene.push(4, {6, 2});
  EXPECT_DOUBLE_EQ(terms().lost_seconds, 1 - 1.25 / 1.5);
  EXPECT_EQ(terms().error_when_not_adopted, 0.25);
  scene.ledger->take(scene::Rebalanced{by_cost(), scene.held({5, 3})});
  EXPECT_EQ(terms().error_when_not_adopted, std::nullopt);
  EXPECT_EQ(terms().lost_seconds, 0);
  scene.search_seconds = 0.875;
  scene.push(5, {5, 3}, Search::adopted);
  EXPECT_EQ(terms().repartition_seconds, 1);
  EXPECT_EQ(terms().since, 5);
}

// Where a part is so small that its quota is no particle, the error is 1 however the others are loaded, and no
// repartition ends the account.
TEST(Ledger, WhatImbalanceCostsStaysANumber) {
  scene::SceneOptions options = by_cost();
  options.part_sizes = {1, 10, 10};
  Pushed scene({0, 10, 10}, options);
  scene.seconds = std::numeric_limits<double>::max();
  for (int step = 1; step < 20; ++step) {
    const scene::DecisionTerms terms = scene.ledger->terms(scene.seconds);
    EXPECT_TRUE(std::isfinite(terms.lost_seconds)) << step;
    const auto order = wire::parse_json(wire::dump_json(to_json(terms)));
    ASSERT_TRUE(order.ok());
    EXPECT_EQ(scene::read_terms(*order).lost_seconds, terms.lost_seconds);
    scene.push(step, {0, 14, 6});
  }
}

TEST(Ledger, RemembersWhoBroughtTheLastStep) {
  Pushed scene({2, 2});
  EXPECT_TRUE(scene.ledger->was_in_last("run", 0));
  EXPECT_EQ(in_words(scene.count(2, {2, 2})), "committed after 0");
  EXPECT_EQ(in_words(scene.count(2, {2, 2})), "refused stale_step");
  EXPECT_TRUE(scene.ledger->was_in_last("run", 2));
  EXPECT_FALSE(scene.ledger->was_in_last("another", 2));
  EXPECT_FALSE(scene.ledger->was_in_last("run", 0));
  EXPECT_EQ(scene.ledger->totals().steps, 2U);
}

TEST(Ledger, HasTooManyPartsToBeJudgedAlone) {
  const auto verdict = [](int parts, bool weighted) {
    const std::vector<std::uint64_t> counts(static_cast<std::size_t>(parts), 1);
    Pushed scene(counts, {}, weighted);
    return in_words(scene.count(1, counts));
  };
  const std::string send = "send: its parts are too many to be judged by one process";
  EXPECT_EQ(verdict(scene::Ledger::kPartsMax, false), "committed after 0");
  EXPECT_EQ(verdict(scene::Ledger::kPartsMax + 1, false), send);
  EXPECT_EQ(verdict(scene::Ledger::kWeightedPartsMax, true), "committed after 0");
  EXPECT_EQ(verdict(scene::Ledger::kWeightedPartsMax + 1, true), send);
}

TEST(Ledger, SendsOnceForAQuestion) {
  Pushed scene({2, 2});
  scene.ledger->want_positions();
  for (int again = 0; again < 2; ++again)
    EXPECT_EQ(in_words(scene.count(1, {2, 2})), "send: a question about positions waits");
  scene.push(1, {2, 2});
  EXPECT_EQ(in_words(scene.count(2, {2, 2})), "committed after 1");
  EXPECT_EQ(scene.ledger->now().positions_step, 1);
  const auto without = [&scene] { return scene.ledger->totals().skipped.at("questions"); };
  EXPECT_EQ(without(), 3U);  // all steps so far
  scene.ledger->take(scene::Asked{"quality"});
  EXPECT_EQ(scene.ledger->totals().asked.at("quality"), 1U);
  scene.count(3, {2, 2});
  EXPECT_EQ(without(), 3U);
  scene.count(4, {2, 2});
  EXPECT_EQ(without(), 4U);
}

TEST(Ledger, OfAnotherIncarnationIsAnotherScene) {
  Pushed scene({2, 2});
  scene.count(1, {2, 2});
  scene.ledgers.take({"jet", Created{scene.ledger->now().options, {}}}, 6);
  scene.ledger = scene.ledgers.find("jet");
  EXPECT_EQ(scene.ledger->history().total(), 0U);
  EXPECT_EQ(in_words(scene.count(1, {2, 2})), "refused not_found");
  scene.push(7, {2, 2}, Search::adopted);
  EXPECT_EQ(in_words(scene.count(3, {2, 2})), "refused not_found");  // rather than a step that is too late
  scene.ledgers.take({"jet", scene::Dropped{}}, 0);
  EXPECT_EQ(scene.ledgers.find("jet"), nullptr);
}

// With room for a single report; which history is asked to give up one must not depend on where it lies in memory.
TEST(Ledger, TheReportOfAStepIsThereWhenItIsTaken) {
  Ledgers ledgers({.keep_reports = 1});
  for (const char* name : {"a", "b", "c", "d"}) ledgers.take({name, Created{}}, 1);
  std::int64_t step = 0;
  for (const char* name : {"d", "c", "b", "a", "b", "c", "d"}) {
    scene::Stepped stepped;
    stepped.report.scene = name;
    stepped.report.step = ++step;
    stepped.held.loads = std::make_shared<const partition::LoadSummary>();
    const scene::StepReport* report = ledgers.take({name, std::move(stepped)}, 0);
    ASSERT_NE(report, nullptr);
    EXPECT_EQ(report->scene, name);
    EXPECT_EQ(report->step, step);
    EXPECT_EQ(ledgers.find(name)->history().newest(0, ledgers.find(name)->history().total()).reports.size(), 1U);
  }
}

}  // namespace
}  // namespace rcb::testing
