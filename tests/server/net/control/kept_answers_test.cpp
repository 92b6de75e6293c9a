#include "server/net/control/kept_answers.hpp"

#include <algorithm>
#include <array>
#include <filesystem>
#include <fstream>
#include <functional>
#include <future>
#include <memory>
#include <random>

#include <gtest/gtest.h>
#include <sys/stat.h>

#include "common/base/random.hpp"
#include "server/net/sockets/file_thread.hpp"
#include "tests/server/net/harness.hpp"

namespace rcb::net::testing {
namespace {

namespace fs = std::filesystem;
using rcb::testing::contents;
using wire::Json;

wire::Array array_of(const std::string& name, std::vector<std::int64_t> values) {
  wire::Array array{name, "<i8", {values.size()}, {}};
  array.bytes.assign(std::as_bytes(std::span(values)));
  return array;
}

// Two members' answers, which differ from step to step.
MemberAnswers answers_of(std::int64_t step) {
  MemberAnswers answers{step, {"00000000000000aa", "00000000000000bb"}, {{"report", {{"step", step}}}}, {}};
  for (const std::int64_t member : {0, 1}) {
    answers.arrays.emplace_back();
    answers.arrays.back().push_back(array_of("changed_id", {step, member, 7}));
    answers.arrays.back().push_back(array_of("inserted_id", {}));
    answers.arrays.back().push_back(array_of("place_id", {1, 2, 3}));
  }
  answers.cuts.push_back(array_of("axes", {step, 1, 0}));
  return answers;
}

void expect_step(const MemberAnswers* found, std::int64_t step) {
  ASSERT_NE(found, nullptr);
  const MemberAnswers expected = answers_of(step);
  EXPECT_EQ(found->step, step);
  EXPECT_EQ(found->sessions, expected.sessions);
  EXPECT_EQ(found->json, expected.json);
  ASSERT_EQ(found->arrays.size(), 2U);
  for (std::size_t member = 0; member < 2; ++member) {
    ASSERT_EQ(found->arrays[member].size(), 3U) << "without places, with the cuts";
    for (std::size_t k = 0; k < 3; ++k) {
      const wire::Array& array = found->arrays[member][k];
      const wire::Array& like = k == 2 ? expected.cuts[0] : expected.arrays[member][k];
      EXPECT_EQ(array.name, like.name);
      EXPECT_EQ(array.shape, like.shape);
      ASSERT_EQ(array.bytes.size(), like.bytes.size());
      EXPECT_TRUE(std::ranges::equal(array.bytes, like.bytes));
    }
  }
}

std::vector<std::string> files_in(const Directory& directory) {
  std::vector<std::string> names;
  for (const auto& entry : fs::directory_iterator(directory.path())) names.push_back(entry.path().filename());
  std::sort(names.begin(), names.end());
  return names;
}

void write_file(const std::string& path, const std::string& bytes, mode_t mode = 0600) {
  std::ofstream(path, std::ios::binary) << bytes;
  ::chmod(path.c_str(), mode);
}

// KeptAnswers and its loop, without a thread of its own.
class Kept {
 public:
  Kept(const std::string& directory, bool restarted) : kept_(context_, directory, restarted) {}
  ~Kept() { settle(); }
  const MemberAnswers* before(const std::string& scene) const { return kept_.before(scene); }
  void forget(const std::string& scene) { kept_.forget(scene); }
  void forget_all() { kept_.forget_all(); }
  // Until they may be sent.
  void keep(const std::string& scene, const MemberAnswers& answers) {
    bool sent = false;
    begin(scene, answers, [&sent] { sent = true; });
    run_until(context_, [&sent] { return sent; });
  }
  void begin(const std::string& scene, const MemberAnswers& answers, std::function<void()> then) {
    kept_.keep(scene, std::make_shared<MemberAnswers>(answers), std::move(then));
  }
  // Until the thread of the files has nothing to do.
  void settle() {
    for (int jobs = 0; jobs < 3; ++jobs) {
      bool idle = false;
      ASSERT_TRUE(FileThread::of(context_).run([] {}, [&idle] { idle = true; }).ok());
      run_until(context_, [&idle] { return idle; });
    }
  }
  asio::io_context& context() { return context_; }

 private:
  asio::io_context context_;
  KeptAnswers kept_;
};

// A disk that stands still: no file is touched until release().
class StillDisk {
 public:
  explicit StillDisk(asio::io_context& context) {
    const auto begun = FileThread::of(context).run([moves = moves_] { moves->get_future().wait(); }, [] {});
    EXPECT_TRUE(begun.ok());
  }
  ~StillDisk() { release(); }
  void release() {
    if (!std::exchange(released_, true)) moves_->set_value();
  }

 private:
  std::shared_ptr<std::promise<void>> moves_ = std::make_shared<std::promise<void>>();
  bool released_ = false;
};

TEST(KeptAnswers, AreSentWhenTheyAreOnDisk) {
  const Directory directory;
  Kept kept(directory.path(), false);
  StillDisk disk(kept.context());
  std::vector<int> sent;
  kept.begin("s", answers_of(1), [&] {
    sent.push_back(1);
    EXPECT_EQ(files_in(directory), std::vector<std::string>{"answers.s.0"});
  });
  kept.begin("t", answers_of(1), [&] { sent.push_back(2); });
  kept.context().poll();
  EXPECT_TRUE(sent.empty());
  disk.release();
  run_until(kept.context(), [&] { return sent.size() == 2; });
  EXPECT_EQ(sent, (std::vector<int>{1, 2}));
  kept.settle();
  expect_step(Kept(directory.path(), true).before("s"), 1);
  expect_step(Kept(directory.path(), true).before("t"), 1);
}

TEST(KeptAnswers, WaitForADiskThatStandsStillOnceAndNotForLong) {
  const Directory directory;
  Kept kept(directory.path(), false);
  StillDisk disk(kept.context());
  kept.keep("s", answers_of(1));  // returns though the disk stands still
  EXPECT_TRUE(files_in(directory).empty());
  for (const std::int64_t step : {2, 3, 4}) {
    bool sent = false;
    kept.begin("s", answers_of(step), [&sent] { sent = true; });
    EXPECT_TRUE(sent) << "nobody waits for it again";
  }
  disk.release();
  kept.settle();
  expect_step(Kept(directory.path(), true).before("s"), 4);
  bool sent = false;
  {
    StillDisk again(kept.context());
    kept.begin("s", answers_of(5), [&sent] { sent = true; });
    EXPECT_FALSE(sent) << "it moves, so it is waited for";
  }
  run_until(kept.context(), [&sent] { return sent; });
}

TEST(KeptAnswers, OfASceneThatIsForgottenMeanwhileAreNotWritten) {
  const Directory directory;
  Kept kept(directory.path(), false);
  kept.keep("s", answers_of(7));
  kept.keep("t", answers_of(7));
  {
    StillDisk disk(kept.context());
    bool sent = false;
    kept.begin("u", answers_of(8), [] {});  // is with the disk
    kept.begin("s", answers_of(8), [&sent] { sent = true; });
    kept.forget("s");
    kept.forget("t");
    kept.begin("t", answers_of(1), [] {});  // of another run, whose steps begin anew
    disk.release();
    kept.settle();
    EXPECT_TRUE(sent);
  }
  EXPECT_EQ(Kept(directory.path(), true).before("s"), nullptr);
  expect_step(Kept(directory.path(), true).before("t"), 1);
}

TEST(KeptAnswers, TheServiceThatIsStartedAgainHasTheLastOnes) {
  const Directory directory;
  {
    Kept kept(directory.path(), false);
    for (const std::int64_t step : {3, 4, 5}) kept.keep("s", answers_of(step));
    kept.keep("..", answers_of(9));
    EXPECT_EQ(kept.before("s"), nullptr) << "its own answers are the group's to give";
  }
  for (int death = 0; death < 2; ++death) {
    Kept kept(directory.path(), true);
    expect_step(kept.before("s"), 5);
    expect_step(kept.before(".."), 9);
    EXPECT_EQ(kept.before("t"), nullptr);
  }
  Kept kept(directory.path(), true);
  kept.keep("s", answers_of(6));
  EXPECT_EQ(kept.before("s"), nullptr);
  expect_step(Kept(directory.path(), true).before("s"), 6);
}

TEST(KeptAnswers, ADeathWhileWritingLeavesThoseBefore) {
  const std::uint64_t seed = std::random_device{}();
  SCOPED_TRACE("seed " + std::to_string(seed));
  Random random(seed);
  const Directory directory;
  Kept(directory.path(), false).keep("s", answers_of(1));
  for (std::int64_t step = 2; step < 40; ++step) {
    const auto before = files_in(directory);
    std::vector<std::string> old;
    for (const std::string& name : before) old.push_back(contents(directory / name));
    Kept(directory.path(), true).keep("s", answers_of(step));
    // The file that was written now: as much of it as was there at the death, over what was there before.
    for (const std::string& name : files_in(directory)) {
      const std::string path = directory / name;
      const std::string now = contents(path);
      const auto found = std::find(before.begin(), before.end(), name);
      const std::string was = found == before.end() ? "" : old[static_cast<std::size_t>(found - before.begin())];
      if (now == was) continue;
      const std::size_t cut = random.below(now.size());
      const std::string mixed = now.substr(0, cut) + (was.size() > cut ? was.substr(cut) : "");
      write_file(path, mixed);
      // Where all bytes that were still to come are those of before, it is whole already.
      expect_step(Kept(directory.path(), true).before("s"), mixed == now ? step : step - 1);
      write_file(path, now);
    }
    expect_step(Kept(directory.path(), true).before("s"), step);
    if (::testing::Test::HasFailure()) return;
  }
}

TEST(KeptAnswers, NothingStaysThatNobodyCanAskFor) {
  const Directory directory;
  write_file(directory / "token", "secret");
  {
    Kept kept(directory.path(), false);
    kept.keep("s", answers_of(3));
    kept.keep("s", answers_of(4));
    kept.keep("t", answers_of(4));
    EXPECT_EQ(files_in(directory), (std::vector<std::string>{"answers.s.0", "answers.s.1", "answers.t.0", "token"}));
    kept.forget("s");
    kept.forget("u");
  }
  EXPECT_EQ(files_in(directory), (std::vector<std::string>{"answers.t.0", "token"}));
  fs::last_write_time(directory / "answers.t.0", fs::file_time_type::clock::now() - std::chrono::hours(2));
  EXPECT_EQ(Kept(directory.path(), true).before("t"), nullptr) << "older than any deadline";
  EXPECT_EQ(files_in(directory), (std::vector<std::string>{"token"}));
  Kept(directory.path(), false).keep("t", answers_of(4));
  EXPECT_EQ(Kept(directory.path(), false).before("t"), nullptr) << "after a clean end";
  EXPECT_EQ(files_in(directory), (std::vector<std::string>{"token"}));
  // A run of the service before, too, may be over.
  Kept(directory.path(), false).keep("t", answers_of(4));
  Kept kept(directory.path(), true);
  expect_step(kept.before("t"), 4);
  kept.forget("t");
  EXPECT_EQ(kept.before("t"), nullptr);
  kept.keep("u", answers_of(5));
  kept.keep("v", answers_of(5));
  kept.forget_all();
  kept.settle();
  EXPECT_EQ(files_in(directory), (std::vector<std::string>{"token"}));
}

TEST(KeptAnswers, WhatTheHeadDoesNotTellIsNotRead) {
  const Directory directory;
  Kept(directory.path(), false).keep("s", answers_of(3));
  fs::resize_file(directory / "answers.s.0", std::uintmax_t{1} << 42U);  // takes no room on the disk
  expect_step(Kept(directory.path(), true).before("s"), 3);
}

TEST(KeptAnswers, WhatIsNotOursOrNotWholeIsNotBelieved) {
  const std::uint64_t seed = std::random_device{}();
  SCOPED_TRACE("seed " + std::to_string(seed));
  Random random(seed);
  const Directory directory;
  Kept(directory.path(), false).keep("s", answers_of(3));
  const std::string path = directory / "answers.s.0";
  const std::string whole = contents(path);
  write_file(path, whole, 0666);
  EXPECT_EQ(Kept(directory.path(), true).before("s"), nullptr) << "others may have written it";
  for (int round = 0; round < 500; ++round) {
    std::string bytes = whole;
    bytes[random.below(bytes.size())] ^= static_cast<char>(1U << random.below(8));
    if (round % 3 == 0) bytes.resize(random.below(bytes.size()));
    write_file(path, bytes);
    EXPECT_EQ(Kept(directory.path(), true).before("s"), nullptr) << round;
  }
  fs::remove(path);
  write_file(directory / "elsewhere", whole);
  fs::create_symlink(directory / "elsewhere", path);
  EXPECT_EQ(Kept(directory.path(), true).before("s"), nullptr) << "a link";
  // Where nothing can be written, nothing else fails.
  Kept nowhere(directory / "missing", false);
  nowhere.keep("s", answers_of(3));
  Kept("", true).keep("s", answers_of(3));
}

}  // namespace
}  // namespace rcb::net::testing
