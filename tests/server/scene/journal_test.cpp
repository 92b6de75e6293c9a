// A journal gives back what was put into it, wherever the process died, whatever the disk refused, and whatever has
// been done to its files.
#include "server/scene/journal.hpp"

#include <algorithm>
#include <csignal>
#include <filesystem>
#include <map>
#include <optional>
#include <random>

#include <fcntl.h>
#include <fmt/format.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "common/base/random.hpp"
#include "server/scene/journal_record.hpp"
#include "tests/support/directory.hpp"
#include "tests/support/simulated_storage.hpp"

namespace rcb::testing {
namespace {

using scene::Journal;
using scene::JournalFound;
using scene::SceneFolder;

const SceneFolder kJet{"jet", 0x0123456789abcdef};
using Reports = std::map<std::uint64_t, std::string>;

// Bytes that tell their version, of a size and content that follow from it.
std::string value_of(const char* kind, std::uint64_t version, std::size_t size_max) {
  Random random(version);
  std::string text = fmt::format("{} {} ", kind, version);
  const std::size_t size = random.below(size_max + 1);
  for (std::size_t k = 0; k < size; ++k) text += static_cast<char>(random.next());
  return text;
}

Reports reports_in(const Journal& journal, std::uint64_t first = 0, std::uint64_t last = ~std::uint64_t{0}) {
  Reports found;
  std::uint64_t least = first;
  const Status read = journal.read(first, last, [&](std::uint64_t number, std::string_view report) {
    EXPECT_TRUE(number >= least && number < last) << number;
    least = number + 1;
    found.emplace(number, report);
  });
  EXPECT_TRUE(read.ok()) << read.message();
  return found;
}

// A value in its slots, as its owner knows it.
struct Known {
  std::string stands;              // put and answered; none yet if empty
  std::string before;              // the one before it, which may be there
  std::vector<std::string> begun;  // being put when a process died, so that they may be there

  void put(std::string value) {
    before = std::exchange(stands, std::move(value));
    begun.clear();
  }
  bool is_begun(const std::string& value) const { return std::find(begun.begin(), begun.end(), value) != begun.end(); }
  // What an open() found must be the newest, or the newest after the one that was begun. Says which of them stands.
  std::size_t check(const std::vector<std::string>& found) {
    if (stands.empty() && found.empty()) return 0;
    if (found.empty()) {
      ADD_FAILURE() << "nothing is left of " << stands.substr(0, 12);
      return 0;
    }
    const bool newer = is_begun(found[0]);
    if (newer && found.size() == 2) {
      EXPECT_TRUE(found[1] == stands) << found[1].substr(0, 12) << " instead of " << stands.substr(0, 12);
      return 1;
    }
    EXPECT_TRUE(newer ? stands.empty() : found[0] == stands)
        << found[0].substr(0, 12) << " instead of " << stands.substr(0, 12);
    EXPECT_TRUE(found.size() == 1 || found[1] == before) << found[1].substr(0, 12);
    return 0;
  }
};

// One scene through several processes, each of which dies at some point.
class Lives {
 public:
  explicit Lives(std::uint64_t seed) : random_(seed), disk_(mix64(seed)) {
    if (random_.below(2) == 0) fault_rate_ = random_.uniform(0, 0.5);
    if (random_.below(3) == 0) disk_.room = random_.below(6U << 20U);
    large_ = random_.below(3) == 0;
  }

  void run() {
    for (int life = 0; life < 4; ++life) {
      disk_.die_after(1 + random_.below(random_.below(2) == 0 ? 15 : 700));
      try {
        start();
        for (int work = 0; work < 900 && !::testing::Test::HasFailure(); ++work) do_something();
        check();
      } catch (const ProcessDied&) {
      }
      disk_.live();
      journal_.reset();
    }
    fault_rate_ = 0;
    start();
    check();
    EXPECT_TRUE(journal_->remove().ok());
    EXPECT_TRUE(disk_.files.empty());
  }
  std::size_t reports() const { return reports_.size(); }

 private:
  void start() {
    disk_.fault_rate = 0;
    if (disk_.files.empty()) {
      auto made = Journal::create(disk_, "data", kJet);
      ASSERT_TRUE(made.ok()) << made.status().message();
      journal_.emplace(std::move(*made));
    } else {
      JournalFound found;
      auto opened = Journal::open(disk_, "data", kJet, found);
      ASSERT_TRUE(opened.ok()) << opened.status().message();
      journal_.emplace(std::move(*opened));
      adopt(state_, found.states);
      if (cuts_.check(found.cuts) == 1 && random_.below(2) == 0) {  // the state doesn't know the newer ones
        journal_->hold_older_cuts();
        cuts_.before = found.cuts[0];  // is the other one in the file from now on
      } else {
        adopt(cuts_, found.cuts);
      }
      EXPECT_TRUE(!forgotten_ || journal_->keep_below(*forgotten_).ok());
      if (begun_report_ && journal_->reports() > reports_.size()) reports_.insert(*begun_report_);
      begun_report_.reset();
      check();
    }
    disk_.fault_rate = fault_rate_;
  }
  static void adopt(Known& known, const std::vector<std::string>& found) {
    known.check(found);
    if (!found.empty() && known.is_begun(found[0])) known.put(found[0]);
    known.begun.clear();
  }

  void check() {
    const double rate = std::exchange(disk_.fault_rate, 0);
    EXPECT_EQ(journal_->reports(), reports_.size());
    EXPECT_EQ(journal_->next_report(), reports_.empty() ? 0 : reports_.rbegin()->first + 1);
    EXPECT_TRUE(reports_in(*journal_) == reports_);
    disk_.fault_rate = rate;
  }

  void do_something() {
    switch (random_.below(8)) {
      case 0:
        return put(cuts_, "cuts", &Journal::put_cuts);
      case 1:
      case 2:
        return put(state_, "state", &Journal::put_state);
      case 3:
        return random_.below(40) == 0 ? forget() : read_some();
      default:
        return append();
    }
  }
  void put(Known& known, const char* kind, Status (Journal::*to)(std::string_view)) {
    const std::size_t size_max = random_.below(50) == 0 ? 100000 : 3000;
    const std::string value = value_of(kind, ++version_, size_max);
    known.begun.push_back(value);
    const Status status = (*journal_.*to)(value);
    if (status.ok()) return known.put(value);
    EXPECT_EQ(status.code(), Code::io_error) << status.message();
    known.begun.pop_back();
  }
  void append() {
    const std::uint64_t number = journal_->next_report() + (random_.below(10) == 0 ? random_.below(5) : 0);
    const std::size_t size_max = !large_ ? 200 : random_.below(60) == 0 ? 1500000 : 30000;
    begun_report_.emplace(number, value_of("report", ++version_, size_max));
    const Status status = journal_->append(number, begun_report_->second);
    if (status.ok()) {
      reports_.insert(*begun_report_);
      forgotten_.reset();  // it has overwritten the first of those
    }
    EXPECT_TRUE(status.ok() || status.code() == Code::io_error) << status.message();
    begun_report_.reset();
  }
  void read_some() {
    const double rate = std::exchange(disk_.fault_rate, 0);
    const std::uint64_t first = random_.below(journal_->next_report() + 3);
    const std::uint64_t last = first + random_.below(20);
    EXPECT_TRUE(reports_in(*journal_, first, last) == Reports(reports_.lower_bound(first), reports_.lower_bound(last)));
    disk_.fault_rate = rate;
  }
  void forget() {
    const std::uint64_t from = random_.below(journal_->next_report() + 1);
    if (!journal_->keep_below(from).ok()) return;
    forgotten_ = std::min(from, forgotten_.value_or(from));
    reports_.erase(reports_.lower_bound(from), reports_.end());
    EXPECT_LE(journal_->next_report(), from);
  }

  Random random_;
  SimulatedStorage disk_;
  double fault_rate_ = 0;
  bool large_ = false;
  std::optional<Journal> journal_;
  std::uint64_t version_ = 0;
  Known state_, cuts_;
  Reports reports_;
  std::optional<std::pair<std::uint64_t, std::string>> begun_report_;
  std::optional<std::uint64_t> forgotten_;  // where an owner would tell the next process to end
};

TEST(Journal, GivesBackWhatWasPutWhereverTheProcessDies) {
  const std::uint64_t seed = std::random_device{}();
  std::size_t reports = 0;
  for (std::uint64_t k = 0; k < 4000 && !HasFailure(); ++k) {
    SCOPED_TRACE(fmt::format("seed {}", seed + k));
    Lives lives(seed + k);
    lives.run();
    reports += lives.reports();
  }
  EXPECT_GT(reports, 4000U);  // else nothing has been tested
}

}  // namespace
}  // namespace rcb::testing
