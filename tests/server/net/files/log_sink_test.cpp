// A rank's log: nobody waits for a reader, and nobody's repeated fault fills the disk.
#include "server/net/files/log_sink.hpp"

#include <climits>
#include <csignal>
#include <memory>
#include <string>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

namespace rcb::net {
namespace {

class Sink : public ::testing::Test {
 protected:
  void SetUp() override {
    ASSERT_EQ(::pipe2(pipe_, O_CLOEXEC), 0);
    ASSERT_GT(::fcntl(pipe_[1], F_SETPIPE_SZ, 65536), 0);
    ::fcntl(pipe_[0], F_SETFL, O_NONBLOCK);
    log_ = std::make_unique<spdlog::logger>("test", std::make_shared<LogSink>(pipe_[1]));
    log_->set_pattern("%l: %v");
    log_->set_level(spdlog::level::trace);
  }
  void TearDown() override {
    ::close(pipe_[0]);
    ::close(pipe_[1]);
  }
  std::string read_all() {
    std::string text;
    char bytes[4096];
    for (ssize_t got = 0; (got = ::read(pipe_[0], bytes, sizeof bytes)) > 0;)
      text.append(bytes, static_cast<std::size_t>(got));
    return text;
  }
  int pipe_[2] = {-1, -1};
  std::unique_ptr<spdlog::logger> log_;
};

TEST_F(Sink, NeverWaitsForItsReaderAndTellsWhatIsMissing) {
  // The test's own time limit tells if one of these blocks.
  for (int i = 0; i < 1000; ++i) log_->debug("line {} {}", i, std::string(100, 'x'));
  const std::string first = read_all();
  EXPECT_NE(first.find("line 0 "), std::string::npos);
  EXPECT_EQ(first.find("line 999 "), std::string::npos);
  log_->debug("afterwards");
  const std::string later = read_all();
  EXPECT_NE(later.find("lines of the log are missing here"), std::string::npos) << later;
  EXPECT_NE(later.find("debug: afterwards\n"), std::string::npos) << later;
}

TEST_F(Sink, CutsWhatAPipeDoesNotTakeAtOnce) {
  log_->debug("{}", std::string(100'000, 'x'));
  const std::string text = read_all();
  EXPECT_LE(text.size(), static_cast<std::size_t>(PIPE_BUF));
  EXPECT_EQ(text.substr(text.size() - 5), " ...\n");
}

TEST_F(Sink, AReaderThatIsGoneIsNoFault) {
  std::signal(SIGPIPE, SIG_IGN);
  ::close(pipe_[0]);
  for (int i = 0; i < 10; ++i) log_->info("line {}", i);
  pipe_[0] = -1;
}

TEST_F(Sink, LimitsInfoButNotWhatWasAskedForNorLastWords) {
  for (int i = 0; i < 30; ++i) {
    log_->info("connection refused: user {}", i);
    log_->debug("frame {}", i);
    log_->critical("the end {}", i);
  }
  const std::string text = read_all();
  EXPECT_NE(text.find("refused: user 9\n"), std::string::npos) << text;
  EXPECT_EQ(text.find("refused: user 10\n"), std::string::npos) << text;
  EXPECT_NE(text.find("frame 29\n"), std::string::npos);
  EXPECT_NE(text.find("the end 29\n"), std::string::npos);
}

TEST(RepeatLimit, LetsAFewPassAndTellsHowManyMoreThereWere) {
  RepeatLimit limit;
  std::uint64_t passed = 0;
  for (int i = 0; i < 1000; ++i)
    passed += limit.admit("info", "push of step " + std::to_string(i) + " of scene 'a' given up", 100) ? 1U : 0U;
  EXPECT_EQ(passed, RepeatLimit::kAlikeMax);
  EXPECT_TRUE(limit.admit("info", "connection refused: too many", 101)) << "another kind";
  EXPECT_TRUE(limit.held_back(100 + RepeatLimit::kPeriodSeconds - 1).empty());
  const auto told = limit.held_back(100 + RepeatLimit::kPeriodSeconds);
  ASSERT_EQ(told.size(), 1U);
  EXPECT_NE(told[0].find("990 more like it"), std::string::npos) << told[0];
  EXPECT_NE(told[0].find("push of step 999"), std::string::npos) << told[0];
  EXPECT_TRUE(limit.admit("info", "push of step 1 of scene 'a' given up", 200));
}

// A client's name is its own choice.
TEST(RepeatLimit, ThousandNamesAreNoWayAround) {
  RepeatLimit limit;
  std::uint64_t passed = 0;
  for (int i = 0; i < 100'000; ++i) {
    std::string name;
    for (int k = i; k > 0; k /= 26) name += static_cast<char>('a' + k % 26);
    passed += limit.admit("info", name + " of nobody: invalid_argument", 5) ? 1U : 0U;
  }
  EXPECT_LE(passed, RepeatLimit::kAllMax);
  const auto told = limit.held_back(5 + RepeatLimit::kPeriodSeconds);
  EXPECT_LE(told.size(), 65U);
  EXPECT_FALSE(told.empty());
}

}  // namespace
}  // namespace rcb::net
