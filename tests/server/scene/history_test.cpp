// Step reports: in memory so many as the room has, the older ones in files, lost ones counted.
#include "server/scene/history.hpp"

#include <filesystem>
#include <fstream>
#include <future>
#include <memory>
#include <thread>

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include "tests/support/directory.hpp"

namespace rcb::scene {
namespace {

namespace fs = std::filesystem;
using rcb::testing::contents;
using rcb::testing::Directory;
using wire::Json;

class ReportDirectory {
 public:
  ReportDirectory() {
    const Status made = make_report_directory(reports);
    EXPECT_TRUE(made.ok()) << made.message();
  }

 private:
  Directory directory_;

 public:
  const std::string reports = directory_ / "reports";
};

// The process writes no file beyond so many bytes: what a full disk is to it.
class FileLimit {
 public:
  explicit FileLimit(rlim_t bytes) : handler_(::signal(SIGXFSZ, SIG_IGN)) {
    ::getrlimit(RLIMIT_FSIZE, &before_);
    rlimit limit = before_;
    limit.rlim_cur = bytes;
    EXPECT_EQ(::setrlimit(RLIMIT_FSIZE, &limit), 0);
  }
  ~FileLimit() {
    ::setrlimit(RLIMIT_FSIZE, &before_);
    ::signal(SIGXFSZ, handler_);
  }

 private:
  rlimit before_{};
  void (*handler_)(int);
};

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

void add(History& history, std::int64_t from, std::int64_t to) {
  for (std::int64_t step = from; step < to; ++step) history.add(report_of(step));
}

FoundReports find(const History& history, std::uint64_t first, std::uint64_t last) {
  std::promise<void> done;
  FoundReports found;
  const Status begun = history.reading(first, last)([&found](FoundReports all) { found = std::move(all); },
                                                    [&done] { done.set_value(); });
  EXPECT_TRUE(begun.ok()) << begun.message();
  if (begun.ok()) done.get_future().wait();
  return found;
}

std::vector<std::int64_t> steps(const History& history, std::uint64_t first, std::uint64_t last) {
  std::vector<std::int64_t> found;
  for (const Json& report : find(history, first, last).reports) {
    found.push_back(report["step"].get<std::int64_t>());
    EXPECT_EQ(report, to_json(report_of(found.back())));
  }
  return found;
}

// Why reports were lost most recently, of those whose writing has begun.
std::string loss(const History& history) { return find(history, 0, 0).loss; }

// Until the disk has taken what is on its way.
void settle(HistoryMemory& room) {
  std::promise<void> done;
  // Refused while as much waits as may.
  while (!room.thread()->post([] {}, [&done] { done.set_value(); }).ok()) std::this_thread::yield();
  done.get_future().wait();
}

std::vector<std::int64_t> range(std::int64_t from, std::int64_t to) {
  std::vector<std::int64_t> numbers;
  for (; from < to; ++from) numbers.push_back(from);
  return numbers;
}

TEST(History, LinesThatAreNoReportsAreLost) {
  const ReportDirectory directory;
  HistoryMemory room(1, directory.reports);
  History history(room, "jet");
  add(history, 0, 400);
  ASSERT_EQ(loss(history), "");
  settle(room);
  const std::string path = report_file_path(directory.reports, "jet");
  std::string text = contents(path);
  const std::size_t line = text.find('\n') + 1;
  std::string same_length(text.find('\n', line) - line, ' ');
  same_length.front() = '{';
  same_length.back() = '}';
  text.replace(line, same_length.size(), same_length);
  std::ofstream(path) << text;
  EXPECT_EQ(steps(history, 0, 3), (std::vector<std::int64_t>{0, 2}));
  EXPECT_NE(loss(history), "");
}

TEST(History, OlderReportsAreInTheFileAndReadBackInPages) {
  const ReportDirectory directory;
  HistoryMemory room(50, directory.reports);
  History history(room, "jet");
  add(history, 0, 3000);
  EXPECT_EQ(history.total(), 3000U);
  EXPECT_LE(room.held(), 50U);
  EXPECT_EQ(steps(history, 0, 3000), range(0, 3000));
  for (const auto& [first, last] : {std::pair{0, 1}, {255, 257}, {700, 1500}, {2900, 3000}, {2999, 3000}, {5, 5}})
    EXPECT_EQ(steps(history, static_cast<std::uint64_t>(first), static_cast<std::uint64_t>(last)), range(first, last));
  EXPECT_EQ(loss(history), "");
}

TEST(History, AllScenesShareTheRoom) {
  const ReportDirectory directory;
  HistoryMemory room(40, directory.reports);
  std::vector<std::unique_ptr<History>> histories;
  for (int k = 0; k < 7; ++k) histories.push_back(std::make_unique<History>(room, fmt::format("s{}", k)));
  for (int k = 0; k < 7; ++k) add(*histories[static_cast<std::size_t>(k)], 0, 30 * (k + 1));
  EXPECT_LE(room.held(), 40U);
  for (int k = 0; k < 7; ++k)
    EXPECT_EQ(steps(*histories[static_cast<std::size_t>(k)], 0, static_cast<std::uint64_t>(30 * (k + 1))),
              range(0, 30 * (k + 1)));
  histories.clear();
  EXPECT_EQ(room.held(), 0U);
  settle(room);
  EXPECT_TRUE(fs::is_empty(directory.reports));
}

TEST(History, FilesArePrivateAndThoseOfAnEarlierRunAreRemoved) {
  const ReportDirectory directory;
  {
    HistoryMemory room(1, directory.reports);
    History history(room, "..");  // a name of two dots is a name
    add(history, 0, 10);
    settle(room);
    const std::string path = report_file_path(directory.reports, "..");
    struct stat found {};
    ASSERT_EQ(::stat(path.c_str(), &found), 0);
    EXPECT_EQ(found.st_mode & 0777U, 0600U);
    fs::copy_file(path, report_file_path(directory.reports, "left-behind"));
  }
  EXPECT_FALSE(fs::is_empty(directory.reports));
  ASSERT_TRUE(make_report_directory(directory.reports).ok());
  EXPECT_TRUE(fs::is_empty(directory.reports));
}

TEST(History, AStrangersLinkIsNotFollowed) {
  const ReportDirectory directory;
  const std::string victim = directory.reports + "/victim";
  std::ofstream(victim) << "mine";
  fs::create_symlink(victim, report_file_path(directory.reports, "jet"));
  HistoryMemory room(1, directory.reports);
  History history(room, "jet");
  add(history, 0, 10);
  settle(room);
  std::string text;
  std::getline(std::ifstream(victim), text);
  EXPECT_EQ(text, "mine");
  EXPECT_EQ(steps(history, 0, 10), range(0, 10));
}

TEST(History, OnAFullDiskReportsAreLostAndCountedAndTheRestIsThere) {
  const ReportDirectory directory;
  HistoryMemory room(8, directory.reports);
  History history(room, "jet");
  add(history, 0, 20);
  settle(room);
  {
    const FileLimit full(8000);
    add(history, 20, 60);  // some have room
    EXPECT_NE(loss(history), "");
  }
  add(history, 60, 100);
  const auto found = steps(history, 0, 100);
  ASSERT_GT(found.size(), 60U);
  ASSERT_LT(found.size(), 100U);
  EXPECT_TRUE(std::is_sorted(found.begin(), found.end()));
  const auto first = range(0, 13), last = range(60, 100);
  EXPECT_TRUE(std::equal(first.begin(), first.end(), found.begin()));
  EXPECT_TRUE(std::equal(last.rbegin(), last.rend(), found.rbegin()));
}

TEST(History, WhoeverTakesTheFileAwayTakesTheReportsInItAlone) {
  for (const std::string how : {"remove", "truncate", "append", "remove the directory", "replace"}) {
    SCOPED_TRACE(how);
    const ReportDirectory directory;
    const std::string path = report_file_path(directory.reports, "jet");
    HistoryMemory room(16, directory.reports);
    History history(room, "jet");
    add(history, 0, 100);
    settle(room);
    if (how == "remove") fs::remove(path);
    if (how == "truncate") fs::resize_file(path, 100);
    if (how == "append") std::ofstream(path, std::ios::app) << "x";
    if (how == "remove the directory") fs::remove_all(directory.reports);
    if (how == "replace") {
      fs::copy_file(path, path + "2");
      fs::rename(path + "2", path);
    }
    steps(history, 0, 100);  // whatever is left of it
    add(history, 100, 200);
    const auto found = steps(history, 0, 200);
    EXPECT_EQ(found, range(200 - static_cast<std::int64_t>(found.size()), 200));
    EXPECT_GE(found.size(), 100U);
    EXPECT_LT(found.size(), 120U);
    EXPECT_NE(loss(history), "");
  }
}

// The thread of the files is held, as by a disk that stands still.
class StillDisk {
 public:
  explicit StillDisk(HistoryMemory& room) {
    EXPECT_TRUE(room.thread()->post([moves = moves_] { moves->get_future().wait(); }).ok());
  }
  ~StillDisk() { moves_->set_value(); }

 private:
  std::shared_ptr<std::promise<void>> moves_ = std::make_shared<std::promise<void>>();
};

TEST(History, ADiskThatStandsStillHoldsUpNobody) {
  const ReportDirectory directory;
  HistoryMemory room(8, directory.reports);
  History history(room, "jet");
  {
    const StillDisk disk(room);
    add(history, 0, 100);
    EXPECT_LE(room.held(), 8U);
    auto gone = std::make_unique<History>(room, "gone");
    add(*gone, 0, 100);
    gone.reset();
  }
  EXPECT_EQ(steps(history, 0, 100), range(0, 100)) << "in its time it has taken all";
  EXPECT_EQ(loss(history), "");
  settle(room);
  EXPECT_FALSE(fs::exists(report_file_path(directory.reports, "gone")));
}

TEST(History, WhatADiskDoesNotTakeInTimeIsLostAndCountedAndTheRestIsThere) {
  const ReportDirectory directory;
  HistoryMemory room(8, directory.reports);
  History history(room, "jet");
  std::int64_t total = 0;
  {
    const StillDisk disk(room);
    for (; history.newest(0, 0).loss.empty() && total < 1'000'000; total += 100) add(history, total, total + 100);
    ASSERT_LT(total, 1'000'000) << "what waits is bounded";
  }
  settle(room);
  add(history, total, total + 100);
  const auto found = steps(history, 0, static_cast<std::uint64_t>(total) + 100);
  EXPECT_LT(found.size(), static_cast<std::size_t>(total) + 100);
  ASSERT_GE(found.size(), 108U);
  const auto first = range(0, 8), last = range(total, total + 100);
  EXPECT_TRUE(std::equal(first.begin(), first.end(), found.begin()));
  EXPECT_TRUE(std::equal(last.rbegin(), last.rend(), found.rbegin()));
}

TEST(History, WithoutADirectoryOldReportsAreLost) {
  HistoryMemory room(16, "");
  History history(room, "jet");
  add(history, 0, 100);
  const auto found = steps(history, 0, 100);
  EXPECT_EQ(found, range(100 - static_cast<std::int64_t>(found.size()), 100));
  EXPECT_LE(found.size(), 16U);
}

}  // namespace
}  // namespace rcb::scene
