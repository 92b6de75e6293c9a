// A journal gives back what was put into it, wherever the process died, whatever the disk refused, and whatever has
// been done to its files.
#include "server/scene/journal.hpp"

#include <algorithm>
#include <csignal>
#include <cstring>
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
  const std::size_t begin = text.size();
  const std::size_t size = begin + random.below(size_max + 1);
  text.resize(size + sizeof(std::uint64_t));
  for (std::size_t k = begin; k < size; k += 8) {
    const std::uint64_t bytes = random.next();
    std::memcpy(text.data() + k, &bytes, sizeof bytes);
  }
  text.resize(size);
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
    large_ = random_.below(6) == 0;
  }

  void run() {
    for (int life = 0; life < 4; ++life) {
      disk_.die_after(1 + random_.below(random_.below(2) == 0 ? 15 : 450));
      try {
        start();
        for (int work = 0; work < 400 && !::testing::Test::HasFailure(); ++work) do_something();
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
    const std::size_t size_max = !large_ ? 200 : random_.below(100) == 0 ? 1500000 : 30000;
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
  for (std::uint64_t k = 0; k < 600 && !HasFailure(); ++k) {
    SCOPED_TRACE(fmt::format("seed {}", seed + k));
    Lives lives(seed + k);
    lives.run();
    reports += lives.reports();
  }
  EXPECT_GT(reports, 800U);  // else nothing has been tested
}

// A journal of a few values on a simulated disk, to be damaged.
class DamagedJournal : public ::testing::Test {
 protected:
  DamagedJournal() {
    auto made = Journal::create(disk_, "data", kJet);
    for (std::uint64_t k = 0; k < 12; ++k) {
      EXPECT_TRUE(k % 4 != 0 || made->put_cuts(value_of("cuts", k, 90)).ok());
      EXPECT_TRUE(made->put_state(value_of("state", k, 90)).ok());
      reports_.emplace(k, value_of("report", k, 90));
      EXPECT_TRUE(made->append(k, reports_[k]).ok());
    }
  }
  // Opens it and checks that all that is found was put; says what was found.
  JournalFound open() {
    JournalFound found;
    auto journal = Journal::open(disk_, "data", kJet, found);
    EXPECT_TRUE(journal.ok()) << journal.status().message();
    if (!journal.ok()) return found;
    check("state", found.states, {11, 10});
    check("cuts", found.cuts, {8, 4});
    found_ = reports_in(*journal);
    EXPECT_EQ(journal->reports(), found_.size());
    EXPECT_TRUE(found_ == Reports(reports_.begin(), reports_.lower_bound(found_.size())));
    // It takes what comes next, whatever was there.
    EXPECT_TRUE(journal->put_state("next state").ok() && journal->put_cuts("next cuts").ok());
    EXPECT_TRUE(journal->append(100, "next").ok());
    JournalFound again;
    journal = Journal::open(disk_, "data", kJet, again);
    EXPECT_TRUE(journal.ok() && again.states[0] == "next state" && again.cuts[0] == "next cuts");
    EXPECT_EQ(journal->reports(), found_.size() + 1);
    EXPECT_EQ(reports_in(*journal)[100], "next");
    return found;
  }
  static void check(const char* kind, const std::vector<std::string>& found, const std::vector<std::uint64_t>& put) {
    std::size_t next = 0;
    for (const std::string& value : found) {
      while (next < put.size() && value != value_of(kind, put[next], 90)) ++next;
      EXPECT_LT(next++, put.size()) << "never put, or out of order: " << value.substr(0, 20);
    }
  }
  std::map<std::string, std::string> saved() const {
    std::map<std::string, std::string> copy;
    for (const auto& [path, bytes] : disk_.files) copy[path] = *bytes;
    return copy;
  }
  void restore(const std::map<std::string, std::string>& copy) {
    disk_.files.clear();
    for (const auto& [path, bytes] : copy) disk_.files[path] = std::make_shared<std::string>(bytes);
  }
  std::string& file(const std::string& name) { return *disk_.files.at(kJet.path("data") + "/" + name); }

  SimulatedStorage disk_{1};
  Reports reports_, found_;
};

TEST_F(DamagedJournal, AnyByteChangedGivesNoWrongValue) {
  const auto whole = saved();
  std::size_t changed = 0;
  for (const auto& [path, bytes] : whole)
    for (std::size_t at = 0; at < bytes.size(); ++at) {
      if (bytes[at] == '\0' && at % 997 != 0 && (at == 0 || bytes[at - 1] == '\0')) continue;  // most of it is unused
      restore(whole);
      (*disk_.files[path])[at] ^= static_cast<char>(1U << (at % 8));
      SCOPED_TRACE(fmt::format("{}, byte {}", path, at));
      const JournalFound found = open();
      EXPECT_TRUE(found.states.size() + found.cuts.size() + found_.size() == 16 || !found.faults.empty());
      EXPECT_GE(found.states.size() + found.cuts.size(), 3U);
      if (HasFailure()) return;
      ++changed;
    }
  EXPECT_GT(changed, 1000U);
}

TEST_F(DamagedJournal, FilesOfAnyLengthAreRead) {
  const auto whole = saved();
  for (const auto& [path, bytes] : whole)
    for (std::size_t size = 0; size < bytes.size() + 40; size += size < 700 ? 1 : 1009) {
      restore(whole);
      disk_.files[path]->resize(size);
      SCOPED_TRACE(fmt::format("{} of {} bytes", path, size));
      open();
      if (HasFailure()) return;
    }
}

TEST_F(DamagedJournal, FilesThatAreMissingAreTold) {
  const auto whole = saved();
  for (const auto& [path, bytes] : whole) {
    restore(whole);
    disk_.files.erase(path);
    const JournalFound found = open();
    EXPECT_EQ(found.states.empty() + found.cuts.empty() + found_.empty(), 1) << path;
    EXPECT_TRUE(found.faults.empty());
  }
}

TEST_F(DamagedJournal, ADiskThatFailsForAMomentLosesNothing) {
  const auto whole = saved();
  int opened = 0;
  for (int k = 0; k < 300; ++k) {
    restore(whole);
    disk_.fault_rate = 0.2;
    JournalFound found;
    const auto journal = Journal::open(disk_, "data", kJet, found);
    disk_.fault_rate = 0;
    if (journal.ok()) {
      ++opened;
      EXPECT_TRUE(found.states.size() == 2 && found.cuts.size() == 2 && journal->reports() == 12);
    } else {
      EXPECT_EQ(journal.status().code(), Code::io_error);
    }
    EXPECT_TRUE(saved() == whole);
  }
  EXPECT_TRUE(opened > 10 && opened < 290) << opened;
}

TEST_F(DamagedJournal, WhatWasForgottenIsNoDamage) {
  JournalFound found;
  auto journal = Journal::open(disk_, "data", kJet, found);
  EXPECT_TRUE(journal->keep_below(5).ok());
  EXPECT_TRUE(journal->append(5, "short").ok());
  journal = Journal::open(disk_, "data", kJet, found);
  EXPECT_EQ(journal->reports(), 6U);
  EXPECT_TRUE(found.faults.empty()) << found.faults[0];
}

TEST_F(DamagedJournal, OneThatIsBeingRemovedHasNoState) {
  const auto whole = saved();
  std::size_t without = 0;
  for (std::uint64_t calls = 1; calls < 10; ++calls)
    for (int coin = 0; coin < 8; ++coin) {
      restore(whole);
      JournalFound found;
      auto journal = Journal::open(disk_, "data", kJet, found);
      disk_.die_after(calls);
      try {
        EXPECT_TRUE(journal->remove().ok());
      } catch (const ProcessDied&) {
      }
      disk_.live();
      journal = Journal::open(disk_, "data", kJet, found);
      EXPECT_TRUE(found.states.empty() || (found.cuts.size() == 2 && journal->reports() == 12));
      EXPECT_TRUE(found.faults.empty());
      if (found.states.empty()) ++without;
    }
  EXPECT_GT(without, 10U);
}

TEST_F(DamagedJournal, FilesOfAnotherIncarnationAreNotTaken) {
  const SceneFolder other{"jet", kJet.incarnation + 1};
  auto made = Journal::create(disk_, "data", other);
  ASSERT_TRUE(made->put_state("foreign").ok() && made->append(0, "foreign").ok());
  for (const char* name : {"state", "steps.0"}) file(name) = *disk_.files.at(other.path("data") + "/" + name);
  const JournalFound found = open();
  EXPECT_TRUE(found.states.empty() && found_.empty());
  EXPECT_EQ(found.faults.size(), 3U) << "the slot, so the file; the first report";
}

// Who can write the files can write their checksums.
TEST_F(DamagedJournal, NumbersOfAnySizeAreSurvived) {
  const std::uint64_t highest = ~std::uint64_t{0};
  for (const std::uint64_t number : {highest, highest >> 1U, highest - 1, std::uint64_t{0}})
    for (const std::uint64_t other : {highest, std::uint64_t{0}, number + 1}) {
      file("state").replace(0, 28, scene::encode_record(number, "1st!", mix64(kJet.incarnation)));
      file("state").replace(file("state").size() / 2, 28, scene::encode_record(other, "2nd!", mix64(kJet.incarnation)));
      JournalFound found;
      auto journal = Journal::open(disk_, "data", kJet, found);
      ASSERT_TRUE(journal.ok() && found.states.size() == 2);
      for (const char* state : {"a", "b", "c"}) {
        ASSERT_TRUE(journal->put_state(state).ok());
        journal = Journal::open(disk_, "data", kJet, found);
        ASSERT_TRUE(journal.ok());
        EXPECT_EQ(found.states.at(0), state) << number << " " << other;
      }
    }
  for (const std::uint64_t number : {highest, highest >> 1U}) {
    file("steps.0").replace(0, 28, scene::encode_record(number, "high", mix64(kJet.incarnation + 2)));
    JournalFound found;
    auto journal = Journal::open(disk_, "data", kJet, found);
    ASSERT_TRUE(journal.ok());
    EXPECT_EQ(journal->reports(), 0U);
    EXPECT_EQ(journal->next_report(), 0U);
    EXPECT_EQ(found.faults.size(), 1U);
  }
}

TEST(Journal, TakesReportsAgainOnceThereIsRoom) {
  SimulatedStorage disk(1);
  disk.room = 3U << 20U;
  auto journal = Journal::create(disk, "data", kJet);
  ASSERT_TRUE(journal->put_state("state").ok() && journal->put_cuts("cuts").ok());
  std::uint64_t number = 0;
  while (journal->append(number, std::string(100000, 'x')).ok()) ++number;
  EXPECT_EQ(number, 20U) << "two segments of ten";
  EXPECT_EQ(journal->append(number, std::string(100000, 'x')).code(), Code::io_error);
  EXPECT_TRUE(journal->append(number + 1, "a short one still fits").ok());
  EXPECT_TRUE(journal->put_state("in place").ok() && journal->put_cuts("in place").ok());
  EXPECT_EQ(journal->put_state(std::string(600000, 's')).code(), Code::io_error);
  disk.room *= 2;
  EXPECT_TRUE(journal->append(number + 2, std::string(100000, 'y')).ok());
  JournalFound found;
  journal = Journal::open(disk, "data", kJet, found);
  EXPECT_EQ(found.states.at(0), "in place");
  EXPECT_TRUE(found.faults.empty());
  EXPECT_EQ(journal->reports(), 22U);
  EXPECT_EQ(journal->next_report(), 23U);
  EXPECT_EQ(reports_in(*journal, number, number + 2).size(), 1U);
}

TEST(Journal, RefusesWhatIsTooLargeOrOutOfOrder) {
  SimulatedStorage disk(1);
  auto journal = Journal::create(disk, "data", kJet);
  const std::string large(scene::kRecordBytesMax + 1, 'x');
  EXPECT_EQ(journal->put_state(large).code(), Code::too_large);
  EXPECT_EQ(journal->append(0, large).code(), Code::too_large);
  EXPECT_TRUE(journal->append(5, "five").ok());
  EXPECT_EQ(journal->append(5, "again").code(), Code::invalid_argument);
  EXPECT_EQ(Journal::create(disk, "data", kJet).status().code(), Code::already_exists);
}

TEST(Journal, FoldersAreListedAndSetAside) {
  SimulatedStorage disk(1);
  EXPECT_TRUE(scene::scene_folders(disk, "data")->empty());
  EXPECT_EQ(*scene::set_scenes_aside(disk, "data"), "");
  for (const char* name : {".", "a.b", "jet"}) {
    auto journal = Journal::create(disk, "data", {name, 7});
    EXPECT_TRUE(journal->put_state(name).ok());
  }
  for (const char* name : {"jet", "jet.7", "jet.000000000000000G", "jet.000000000000000A", ".0000000000000007",
                           "j t.0000000000000007", "jet-0000000000000007"})
    EXPECT_TRUE(disk.make_folder(std::string("data/scenes/") + name).ok());
  std::string listed;
  const auto folders = scene::scene_folders(disk, "data");
  for (const SceneFolder& folder : *folders) listed += fmt::format("{} {}, ", folder.name, folder.incarnation);
  EXPECT_EQ(listed, ". 7, a.b 7, jet 7, ");
  EXPECT_EQ(*scene::set_scenes_aside(disk, "data"), "data/scenes.old-1");
  EXPECT_TRUE(scene::scene_folders(disk, "data")->empty());
  EXPECT_TRUE(Journal::create(disk, "data", kJet).ok());
  EXPECT_EQ(*scene::set_scenes_aside(disk, "data"), "data/scenes.old-2");
  EXPECT_TRUE(disk.files.contains("data/scenes.old-1/jet.0000000000000007/state"));
}

// On a real disk.
class JournalOnDisk : public DirectoryTest {
 protected:
  std::string path(const std::string& name) const { return kJet.path(directory_) + "/" + name; }
  Journal create() {
    auto journal = Journal::create(*disk_, directory_, kJet);
    return std::move(*journal);
  }
  Journal open(JournalFound& found) {
    auto journal = Journal::open(*disk_, directory_, kJet, found);
    RCB_CHECK(journal.ok(), journal.status().message());
    return std::move(*journal);
  }
  const std::unique_ptr<scene::Storage> disk_ = scene::disk_storage();
};

TEST_F(JournalOnDisk, OutlivesItsObjectAndGoesWithItsScene) {
  {
    Journal journal = create();
    EXPECT_TRUE(journal.put_state("state").ok() && journal.put_cuts(std::string(100000, 'c')).ok());
    for (std::uint64_t k = 0; k < 30; ++k) EXPECT_TRUE(journal.append(k, std::string(100000, 'r')).ok());
  }
  for (const char* name : {"state", "cuts", "steps.0", "steps.2"}) {
    EXPECT_EQ(mode_of(path(name)), 0600U);
    struct stat info {};
    EXPECT_EQ(::stat(path(name).c_str(), &info), 0);
    EXPECT_GE(info.st_blocks * 512, info.st_size) << name << " has holes";
  }
  EXPECT_EQ(mode_of(kJet.path(directory_)), 0700U);
  EXPECT_EQ(scene::scene_folders(*disk_, directory_)->size(), 1U);
  JournalFound found;
  Journal journal = open(found);
  EXPECT_EQ(found.states.at(0), "state");
  EXPECT_EQ(found.cuts.at(0).size(), 100000U);
  EXPECT_TRUE(found.faults.empty());
  EXPECT_EQ(reports_in(journal).size(), 30U);
  EXPECT_EQ(reports_in(journal, 28).at(29).size(), 100000U);
  EXPECT_TRUE(journal.remove().ok());
  EXPECT_TRUE(scene::scene_folders(*disk_, directory_)->empty());
  EXPECT_EQ(*scene::set_scenes_aside(*disk_, directory_), at("scenes.old-1"));
}

TEST_F(JournalOnDisk, OutlivesAProcessThatIsKilled) {
  const std::uint64_t seed = std::random_device{}();
  Random random(seed);
  SCOPED_TRACE(fmt::format("seed {}", seed));
  for (std::uint64_t round = 0; round < 20; ++round) {
    int ends[2];
    ASSERT_EQ(::pipe(ends), 0);
    const pid_t child = ::fork();
    if (child == 0) {
      const SceneFolder scene{"jet", round};
      auto journal = Journal::create(*disk_, directory_, scene);
      for (std::uint64_t k = 0;; ++k) {
        const bool kept =
            journal->put_state(value_of("state", k, 9000)).ok() && journal->append(k, value_of("report", k, 9000)).ok();
        if (!kept || ::write(ends[1], "k", 1) != 1) ::_exit(1);
      }
    }
    ::close(ends[1]);
    std::uint64_t done = 0;
    char byte = 0;
    for (const std::uint64_t last = 1 + random.below(500); done < last && ::read(ends[0], &byte, 1) == 1;) ++done;
    ::kill(child, SIGKILL);
    ::waitpid(child, nullptr, 0);
    while (::read(ends[0], &byte, 1) == 1) ++done;
    ::close(ends[0]);
    JournalFound found;
    auto journal = Journal::open(*disk_, directory_, {"jet", round}, found);
    ASSERT_TRUE(journal.ok());
    const std::uint64_t kept = journal->reports();
    EXPECT_TRUE(kept == done || kept == done + 1) << kept << " of " << done;
    EXPECT_TRUE(found.states.at(0) == value_of("state", kept, 9000) ||
                found.states.at(0) == value_of("state", kept - 1, 9000));
    const Reports reports = reports_in(*journal);
    for (std::uint64_t k = 0; k < kept; ++k) EXPECT_TRUE(reports.at(k) == value_of("report", k, 9000)) << k;
  }
}

TEST_F(JournalOnDisk, FilesThatAreNoneOfItsOwnAreNotFollowed) {
  {
    Journal journal = create();
    EXPECT_TRUE(journal.put_state("state").ok() && journal.put_cuts("cuts").ok() && journal.append(0, "report").ok());
  }
  for (const char* name : {"state", "cuts", "steps.0"}) std::filesystem::rename(path(name), at(name));
  std::filesystem::create_symlink(at("state"), path("state"));
  ASSERT_EQ(::mkfifo(path("cuts").c_str(), 0600), 0);
  std::filesystem::create_hard_link(at("steps.0"), path("steps.0"));
  JournalFound found;
  {
    Journal journal = open(found);
    EXPECT_TRUE(found.states.empty() && found.cuts.empty() && journal.reports() == 0);
    EXPECT_EQ(found.faults.size(), 2U);
    const std::string before = contents(at("steps.0")) + contents(at("state"));
    EXPECT_TRUE(journal.put_state("new").ok() && journal.put_cuts("new").ok() && journal.append(0, "new").ok());
    EXPECT_TRUE(contents(at("steps.0")) + contents(at("state")) == before);
  }
  Journal journal = open(found);
  EXPECT_TRUE(found.states.at(0) == "new" && found.cuts.at(0) == "new" && journal.reports() == 1);
  std::filesystem::resize_file(path("steps.0"), scene::Storage::kFileBytesMax + 1);
  EXPECT_EQ(open(found).reports(), 0U) << "a file that is larger than any";
}

// The process may make no file beyond so many bytes: what a full disk is to it.
TEST_F(JournalOnDisk, AFullDiskLosesReportsOnly) {
  Journal journal = create();
  EXPECT_TRUE(journal.put_state("state").ok() && journal.put_cuts("cuts").ok());
  void (*handler)(int) = ::signal(SIGXFSZ, SIG_IGN);
  rlimit before{};
  ::getrlimit(RLIMIT_FSIZE, &before);
  rlimit little = before;
  little.rlim_cur = 100000;
  ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &little), 0);
  const Status lost = journal.append(0, "lost");
  const Status large = journal.put_state(std::string(100000, 's'));
  const Status small = journal.put_state("small");
  ::setrlimit(RLIMIT_FSIZE, &before);
  ::signal(SIGXFSZ, handler);
  EXPECT_EQ(lost.code(), Code::io_error);
  EXPECT_NE(lost.message().find("steps.0"), std::string::npos) << lost.message();
  EXPECT_NE(lost.hint().find("make room"), std::string::npos) << lost.hint();
  EXPECT_EQ(large.code(), Code::io_error);
  EXPECT_TRUE(small.ok());
  EXPECT_FALSE(std::filesystem::exists(path("steps.0")));
  EXPECT_TRUE(journal.append(1, "kept").ok());
  JournalFound found;
  journal = open(found);
  EXPECT_EQ(found.states.at(0), "small");
  EXPECT_EQ(journal.reports(), 1U);
}

}  // namespace
}  // namespace rcb::testing
