// Step reports: in memory so many as the room has, the older ones in the scene's journal, lost ones told.
#include "server/scene/history.hpp"

#include <future>
#include <memory>
#include <vector>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "tests/support/simulated_storage.hpp"

namespace rcb::testing {
namespace {

using scene::History;
using scene::HistoryMemory;
using scene::Journal;
using wire::Json;

scene::StepReport report_of(std::int64_t step) {
  scene::StepReport report;
  report.scene = "jet";
  report.step = step;
  report.n = 7;
  report.error = 1.0 / static_cast<double>(step + 3);
  report.reason = fmt::format("error {} is below the tolerance 0.1", report.error);
  report.skipped.add(scene::Skip::search);
  return report;
}

// A history and its journal.
class Kept {
 public:
  Kept(HistoryMemory& memory, SimulatedStorage& disk, const std::string& scene = "jet", std::uint64_t total = 0)
      : journal(journal_of(disk, scene)), history(memory, scene, total) {}
  void add(std::int64_t from, std::int64_t to) {
    for (std::int64_t step = from; step < to; ++step)
      history.add(report_of(step), to_json(report_of(step)), journal.get());
  }
  scene::FoundReports find(std::uint64_t first, std::uint64_t last) const {
    return found_by(history.reading(first, last, journal.get()));
  }
  static scene::FoundReports found_by(const History::Reading& reading) {
    std::promise<void> done;
    scene::FoundReports found;
    const Status begun =
        reading([&found](scene::FoundReports all) { found = std::move(all); }, [&done] { done.set_value(); });
    EXPECT_TRUE(begun.ok()) << begun.message();
    if (begun.ok()) done.get_future().wait();
    return found;
  }
  std::vector<std::int64_t> steps(std::uint64_t first, std::uint64_t last) const { return steps_of(find(first, last)); }
  static std::vector<std::int64_t> steps_of(const scene::FoundReports& found) {
    std::vector<std::int64_t> steps;
    for (const Json& report : found.reports) {
      steps.push_back(report["step"].get<std::int64_t>());
      EXPECT_EQ(report, to_json(report_of(steps.back())));
    }
    return steps;
  }
  // Why reports were lost most recently.
  std::string loss() const { return find(0, 0).loss; }

  std::unique_ptr<Journal> journal;
  History history;

 private:
  static std::unique_ptr<Journal> journal_of(SimulatedStorage& disk, const std::string& scene) {
    auto made = Journal::create(disk, "data", {scene, 1});
    return std::make_unique<Journal>(std::move(*made));
  }
};

std::vector<std::int64_t> range(std::int64_t from, std::int64_t to) {
  std::vector<std::int64_t> numbers;
  for (; from < to; ++from) numbers.push_back(from);
  return numbers;
}

TEST(History, OlderReportsAreInTheJournalAndReadBackInPages) {
  SimulatedStorage disk(1);
  HistoryMemory room(50);
  Kept kept(room, disk);
  kept.add(0, 3000);
  EXPECT_EQ(kept.history.total(), 3000U);
  EXPECT_LE(room.held(), 50U);
  EXPECT_FALSE(kept.history.in_memory(2900));
  EXPECT_EQ(kept.steps(0, 3000), range(0, 3000));
  for (const auto& [first, last] : {std::pair{0, 1}, {255, 257}, {700, 1500}, {2900, 3000}, {2999, 3000}, {5, 5}})
    EXPECT_EQ(kept.steps(static_cast<std::uint64_t>(first), static_cast<std::uint64_t>(last)), range(first, last));
  EXPECT_EQ(kept.loss(), "");
}

TEST(History, ReadsWhatThereWasThen) {
  SimulatedStorage disk(1);
  HistoryMemory room(10);
  Kept kept(room, disk);
  kept.add(0, 100);
  const History::Reading then = kept.history.reading(0, 100, kept.journal.get());
  kept.add(100, 5000);
  EXPECT_EQ(Kept::steps_of(Kept::found_by(then)), range(0, 100));
}

TEST(History, AllScenesShareTheRoom) {
  SimulatedStorage disk(1);
  HistoryMemory room(40);
  std::vector<std::unique_ptr<Kept>> scenes;
  for (int k = 0; k < 7; ++k) scenes.push_back(std::make_unique<Kept>(room, disk, fmt::format("s{}", k)));
  for (int k = 0; k < 7; ++k) scenes[static_cast<std::size_t>(k)]->add(0, 30 * (k + 1));
  EXPECT_LE(room.held(), 40U);
  for (int k = 0; k < 7; ++k) {
    const Kept& one = *scenes[static_cast<std::size_t>(k)];
    EXPECT_EQ(one.steps(0, one.history.total()), range(0, 30 * (k + 1)));
  }
  scenes.clear();
  EXPECT_EQ(room.held(), 0U);
}

TEST(History, TheNewestReportStaysWhateverTheRoom) {
  SimulatedStorage disk(1);
  HistoryMemory room(1);
  Kept one(room, disk, "one"), other(room, disk, "other");
  for (std::int64_t step = 0; step < 20; ++step)
    for (Kept* each : {&one, &other}) {
      each->add(step, step + 1);
      EXPECT_EQ(each->history.last().step, step);
      EXPECT_EQ(room.held(), 1U);
    }
}

TEST(History, GoesOnWithThatOfAnEarlierService) {
  SimulatedStorage disk(1);
  HistoryMemory room(2);
  Kept kept(room, disk, "jet", 3);
  for (std::uint64_t number = 0; number < 3; ++number) {
    const std::string text = number == 1 ? "{\"no\":" : to_json(report_of(static_cast<std::int64_t>(number))).dump();
    ASSERT_TRUE(kept.journal->append(number, text).ok());
  }
  kept.add(3, 10);
  EXPECT_EQ(kept.history.total(), 10U);
  EXPECT_EQ(kept.steps(0, 10), (std::vector<std::int64_t>{0, 2, 3, 4, 5, 6, 7, 8, 9})) << "what is no report is lost";
}

TEST(History, OnAFullDiskReportsAreLostAndToldAndTheRestIsThere) {
  SimulatedStorage disk(1);
  disk.room = std::size_t{2} << 20U;
  HistoryMemory room(8);
  Kept kept(room, disk);
  std::int64_t total = 0;
  for (; kept.history.newest(0, 0).loss.empty() && total < 100'000; ++total) kept.add(total, total + 1);
  ASSERT_LT(total, 100'000);
  const std::int64_t first_lost = total - 1;
  kept.add(total, total + 50);
  disk.room *= 2;
  kept.add(total + 50, total + 100);
  const auto found = kept.steps(0, static_cast<std::uint64_t>(total) + 100);
  EXPECT_NE(kept.loss(), "");
  EXPECT_TRUE(std::is_sorted(found.begin(), found.end()));
  const auto before = range(0, first_lost), after = range(total + 50, total + 100);
  ASSERT_GE(found.size(), before.size() + after.size());
  EXPECT_LT(found.size(), static_cast<std::size_t>(total) + 100);
  EXPECT_TRUE(std::equal(before.begin(), before.end(), found.begin()));
  EXPECT_TRUE(std::equal(after.rbegin(), after.rend(), found.rbegin()));
}

TEST(History, WhoeverTakesTheFilesAwayTakesTheReportsInThemAlone) {
  SimulatedStorage disk(1);
  HistoryMemory room(16);
  Kept kept(room, disk);
  kept.add(0, 100);
  disk.files.clear();
  const auto found = kept.steps(0, 100);
  EXPECT_EQ(found, range(100 - static_cast<std::int64_t>(found.size()), 100));
  EXPECT_GE(found.size(), 10U);
  EXPECT_NE(kept.find(0, 100).loss, "");
}

TEST(History, WithoutAJournalOldReportsAreLost) {
  SimulatedStorage disk(1);
  HistoryMemory room(16);
  Kept kept(room, disk);
  kept.journal.reset();
  kept.add(0, 100);
  const auto found = kept.steps(0, 100);
  EXPECT_EQ(found, range(100 - static_cast<std::int64_t>(found.size()), 100));
  EXPECT_LE(found.size(), 16U);
  EXPECT_NE(kept.loss(), "");
}

}  // namespace
}  // namespace rcb::testing
