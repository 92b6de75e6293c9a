// Step reports: so many in memory as there is room for, the older ones in journals, lost ones counted.
#include "server/scene/history.hpp"

#include <algorithm>
#include <atomic>
#include <filesystem>
#include <future>
#include <memory>
#include <numeric>
#include <optional>
#include <thread>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "tests/support/directory.hpp"
#include "tests/support/simulated_storage.hpp"
#include "tests/support/wait.hpp"

namespace rcb::scene {
namespace {

namespace fs = std::filesystem;
using rcb::testing::Directory;
using rcb::testing::SimulatedStorage;
using wire::Json;

constexpr std::size_t kSegment = std::size_t{1} << 20U;

StepReport report_of(std::int64_t step) {
  StepReport report;
  report.scene = "jet";
  report.step = step;
  report.n = 7;
  report.error = 1.0 / static_cast<double>(step + 3);
  report.reason = fmt::format("error {} is below the tolerance 0.1", report.error);
  report.skipped.add(Skip::search);
  return report;
}

// A scene's journal and history.
struct Scene {
  Scene(HistoryMemory& memory, Storage& storage, const std::string& data, const std::string& name = "jet")
      : folder{name, 7}, journal(Journal::create(storage, data, folder).value()), history(memory, name) {}
  void add(std::int64_t from, std::int64_t to) {
    for (std::int64_t step = from; step < to; ++step) {
      const StepReport report = report_of(step);
      history.add(report, wire::dump_json(to_json(report)), &journal);
    }
  }
  SceneFolder folder;
  Journal journal;
  History history;
};

// What is found once the thread has read it; the test fails where it isn't asked.
FoundReports found_by(const History::Reading& reading) {
  std::promise<void> done;
  FoundReports found;
  const Status begun = reading([&found](FoundReports all) { found = std::move(all); }, [&done] { done.set_value(); });
  EXPECT_TRUE(begun.ok()) << begun.message();
  if (begun.ok()) done.get_future().wait();
  return found;
}

FoundReports find(const Scene& scene, std::uint64_t first, std::uint64_t last) {
  return found_by(scene.history.reading(first, last, &scene.journal));
}

std::vector<std::int64_t> steps_of(const FoundReports& found) {
  std::vector<std::int64_t> steps;
  for (const Json& report : found.reports) {
    steps.push_back(report["step"].get<std::int64_t>());
    EXPECT_EQ(report, to_json(report_of(steps.back())));
  }
  return steps;
}

std::vector<std::int64_t> steps(const Scene& scene, std::uint64_t first, std::uint64_t last) {
  return steps_of(find(scene, first, last));
}

std::vector<std::int64_t> range(std::int64_t from, std::int64_t to) {
  std::vector<std::int64_t> numbers(static_cast<std::size_t>(to - from));
  std::iota(numbers.begin(), numbers.end(), from);
  return numbers;
}

class HistoryOnDisk : public ::testing::Test {
 protected:
  std::string path(const Scene& scene) const { return scene.folder.path(data_); }

  Directory directory_;
  const std::string data_ = directory_ / "data";
  std::shared_ptr<Storage> storage_ = disk_storage();
};

TEST_F(HistoryOnDisk, OlderReportsAreInTheJournalAndReadBackInPages) {
  HistoryMemory memory(50, storage_);
  Scene scene(memory, *storage_, data_);
  scene.add(0, 3000);
  EXPECT_EQ(scene.history.total(), 3000U);
  EXPECT_LE(memory.held(), 50U);
  EXPECT_FALSE(scene.history.in_memory(2900));
  EXPECT_TRUE(scene.history.in_memory(2999));
  EXPECT_EQ(steps(scene, 0, 3000), range(0, 3000));
  for (const auto& [first, last] : {std::pair{0, 1}, {255, 257}, {700, 1500}, {2900, 3000}, {2999, 3000}, {5, 5}})
    EXPECT_EQ(steps(scene, static_cast<std::uint64_t>(first), static_cast<std::uint64_t>(last)), range(first, last));
  EXPECT_EQ(find(scene, 0, 3000).loss, "");
}

TEST_F(HistoryOnDisk, AllScenesShareTheMemory) {
  HistoryMemory memory(40, storage_);
  std::vector<std::unique_ptr<Scene>> scenes;
  for (int k = 0; k < 7; ++k)
    scenes.push_back(std::make_unique<Scene>(memory, *storage_, data_, fmt::format("s{}", k)));
  for (int k = 0; k < 7; ++k) scenes[static_cast<std::size_t>(k)]->add(0, 30 * (k + 1));
  EXPECT_LE(memory.held(), 40U);
  for (int k = 0; k < 7; ++k)
    EXPECT_EQ(steps(*scenes[static_cast<std::size_t>(k)], 0, static_cast<std::uint64_t>(30 * (k + 1))),
              range(0, 30 * (k + 1)));
  scenes.clear();
  EXPECT_EQ(memory.held(), 0U);
}

TEST_F(HistoryOnDisk, WhatIsAskedForIsThatOfTheMomentWhateverComesMeanwhile) {
  HistoryMemory memory(50, storage_);
  Scene scene(memory, *storage_, data_);
  std::vector<std::pair<std::int64_t, History::Reading>> readings;
  for (std::int64_t step = 0; step < 6000; step += 600) {  // over several segments
    scene.add(step, step + 600);
    readings.emplace_back(step + 600, scene.history.reading(0, static_cast<std::uint64_t>(step) + 600, &scene.journal));
  }
  ASSERT_TRUE(fs::exists(path(scene) + "/steps.2"));
  std::vector<std::future<void>> done;
  std::vector<FoundReports> found(readings.size());
  for (std::size_t k = 0; k < readings.size(); ++k) {
    auto whole = std::make_shared<std::promise<void>>();
    done.push_back(whole->get_future());
    const Status begun = readings[k].second([into = &found[k]](FoundReports all) { *into = std::move(all); },
                                            [whole] { whole->set_value(); });
    ASSERT_TRUE(begun.ok()) << begun.message();
    scene.add(6000 + 100 * static_cast<std::int64_t>(k),
              6100 + 100 * static_cast<std::int64_t>(k));  // as they are read
  }
  for (std::size_t k = 0; k < readings.size(); ++k) {
    done[k].wait();
    EXPECT_EQ(steps_of(found[k]), range(0, readings[k].first));
  }
}

TEST_F(HistoryOnDisk, WhoeverTakesTheFilesAwayTakesTheReportsInThemAlone) {
  for (const std::string how : {"remove", "remove the folder", "damage", "replace"}) {
    SCOPED_TRACE(how);
    HistoryMemory memory(16, storage_);
    Scene scene(memory, *storage_, data_, how == "remove the folder" ? "folder" : how);
    scene.add(0, 100);
    const std::string file = path(scene) + "/steps.0";
    if (how == "remove") fs::remove(file);
    if (how == "remove the folder") fs::remove_all(path(scene));
    if (how == "damage") {
      const auto opened = storage_->open_file(file, Storage::Access::write);
      (*opened)->store(20'000, "damage");
    }
    if (how == "replace") {
      fs::rename(file, file + "2");
      ASSERT_TRUE(storage_->make_file(file, kSegment).ok());
    }
    FoundReports left = find(scene, 0, 100);
    EXPECT_NE(left.loss, "");
    const auto before = steps_of(left);
    EXPECT_LE(before.size(), how == "damage" ? 99U : 16U);
    EXPECT_TRUE(std::ranges::is_sorted(before));
    scene.add(100, 200);
    const auto all = steps(scene, 0, 200);
    ASSERT_FALSE(all.empty());
    EXPECT_EQ(all.back(), 199) << "the newest are in memory";
    EXPECT_LT(all.size(), 200U);
  }
}

TEST(History, OnAFullDiskReportsAreLostAndCountedAndTheRestIsThere) {
  const auto storage = std::make_shared<SimulatedStorage>(1);
  storage->room = kSegment;
  HistoryMemory memory(8, storage);
  Scene scene(memory, *storage, "data");
  scene.add(0, 5000);
  const FoundReports full = find(scene, 0, 5000);
  EXPECT_NE(full.loss.find("no space"), std::string::npos) << full.loss;
  const auto kept = static_cast<std::int64_t>(scene.journal.reports());
  ASSERT_TRUE(kept > 1000 && kept < 4000) << kept;
  const auto early = steps_of(full);
  EXPECT_EQ(std::vector(early.begin(), early.begin() + kept), range(0, kept));
  storage->room = 8 * kSegment;
  scene.add(5000, 6000);
  auto expected = range(0, kept);
  const auto late = range(5000, 6000);
  expected.insert(expected.end(), late.begin(), late.end());
  EXPECT_EQ(steps(scene, 0, 6000), expected);
}

TEST(History, WithoutAJournalOldReportsAreLost) {
  HistoryMemory memory(16);
  History history(memory, "jet");
  for (std::int64_t step = 0; step < 100; ++step) history.add(report_of(step), {}, nullptr);
  const FoundReports found = found_by(history.reading(0, 100, nullptr));
  const auto steps = steps_of(found);
  EXPECT_EQ(steps, range(100 - static_cast<std::int64_t>(steps.size()), 100));
  EXPECT_LE(steps.size(), 16U);
  EXPECT_NE(found.loss.find("data directory"), std::string::npos) << found.loss;
}

TEST(History, OfAnEarlierServiceIsInTheJournal) {
  const auto storage = std::make_shared<SimulatedStorage>(1);
  HistoryMemory memory(8, storage);
  Scene scene(memory, *storage, "data");
  scene.add(0, 50);
  JournalFound found;
  auto opened = Journal::open(*storage, "data", scene.folder, found);
  Journal& again = *opened;
  History history(memory, "jet", 52, "the disk was full");
  EXPECT_FALSE(history.in_memory(51));
  FoundReports old = found_by(history.reading(0, 52, &again));
  EXPECT_EQ(steps_of(old), range(0, 50));
  EXPECT_EQ(old.loss, "the disk was full");
  history.add(report_of(52), wire::dump_json(to_json(report_of(52))), &again);
  old = found_by(history.reading(48, 53, &again));
  EXPECT_EQ(steps_of(old), (std::vector<std::int64_t>{48, 49, 52}));
}

// A disk on which whoever reads stands still until it is told to go on.
class StillDisk final : public Storage {
 public:
  Status make_folder(const std::string& path) override { return disk_.make_folder(path); }
  Result<std::vector<std::string>> names_in(const std::string& folder) const override { return disk_.names_in(folder); }
  Result<std::unique_ptr<MappedFile>> make_file(const std::string& path, std::size_t bytes) override {
    return disk_.make_file(path, bytes);
  }
  Result<std::unique_ptr<MappedFile>> open_file(const std::string& path, Access access) const override {
    if (access == Access::read) {
      ++*readers_;
      moves_.wait();
    }
    return disk_.open_file(path, access);
  }
  Status rename(const std::string& from, const std::string& to) override { return disk_.rename(from, to); }
  Status remove(const std::string& path) override { return disk_.remove(path); }

  StillDisk(std::shared_future<void> moves, std::shared_ptr<std::atomic<int>> readers)
      : moves_(std::move(moves)), readers_(std::move(readers)) {}

 private:
  SimulatedStorage disk_{1};
  std::shared_future<void> moves_;
  std::shared_ptr<std::atomic<int>> readers_;
};

class HistoryOnAStillDisk : public ::testing::Test {
 protected:
  ~HistoryOnAStillDisk() override {
    if (!moving_) moves_.set_value();
  }
  void move() {
    moving_ = true;
    moves_.set_value();
  }
  // Begins to read; what is found goes to the result.
  static std::future<FoundReports> begin(const Scene& scene, std::uint64_t first, std::uint64_t last) {
    auto found = std::make_shared<std::promise<FoundReports>>();
    auto all = std::make_shared<FoundReports>();
    const Status begun = scene.history.reading(first, last, &scene.journal)(
        [all](FoundReports these) { *all = std::move(these); }, [all, found] { found->set_value(std::move(*all)); });
    EXPECT_TRUE(begun.ok()) << begun.message();
    return found->get_future();
  }

  std::promise<void> moves_;
  bool moving_ = false;
  std::shared_ptr<std::atomic<int>> readers_ = std::make_shared<std::atomic<int>>(0);
  std::shared_ptr<Storage> storage_ = std::make_shared<StillDisk>(moves_.get_future().share(), readers_);
};

TEST_F(HistoryOnAStillDisk, HoldsUpNobodyButThoseWhoAskForItsReports) {
  HistoryMemory memory(8, storage_);
  Scene scene(memory, *storage_, "data");
  scene.add(0, 100);
  auto old = begin(scene, 0, 100);
  ASSERT_TRUE(rcb::testing::eventually([this] { return *readers_ > 0; }));
  scene.add(100, 1000);
  EXPECT_LE(memory.held(), 8U);
  EXPECT_EQ(scene.history.newest(999, 1000).reports.at(0)["step"], 999);
  auto other = std::make_unique<Scene>(memory, *storage_, "data", "gone");
  other->add(0, 100);
  auto lost = begin(*other, 0, 100);
  EXPECT_TRUE(other->journal.remove().ok());
  other.reset();
  move();
  EXPECT_EQ(steps_of(old.get()), range(0, 100));
  const FoundReports left = lost.get();  // those that were in memory
  EXPECT_NE(left.loss, "");
  EXPECT_LE(left.reports.size(), 8U);
}

TEST_F(HistoryOnAStillDisk, RefusesWhoeverAsksWhenTooManyWait) {
  HistoryMemory memory(8, storage_);
  Scene scene(memory, *storage_, "data");
  scene.add(0, 100);
  std::vector<std::future<FoundReports>> waiting;
  const auto reading = scene.history.reading(0, 100, &scene.journal);
  Status refused;
  for (int k = 0; k < 5000 && refused.ok(); ++k) refused = reading([](const FoundReports&) {}, [] {});
  EXPECT_EQ(refused.code(), Code::busy);
  move();
}

// The thread is left to itself, and owns what it reads from.
TEST_F(HistoryOnAStillDisk, MayHangLongerThanTheHistoryIsThere) {
  const std::weak_ptr<Storage> disk = storage_;
  {
    HistoryMemory memory(8, storage_);
    Scene scene(memory, *storage_, "data");
    scene.add(0, 100);
    begin(scene, 0, 100);
    ASSERT_TRUE(rcb::testing::eventually([this] { return *readers_ > 0; }));
  }
  storage_.reset();
  EXPECT_FALSE(disk.expired());
  move();
  EXPECT_TRUE(rcb::testing::eventually([&disk] { return disk.expired(); }));
}

}  // namespace
}  // namespace rcb::scene
