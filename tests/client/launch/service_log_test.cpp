// The log is bounded, survives a full disk and its own removal, and takes no foreign file for its own.
#include "client/launch/service_log.hpp"

#include <csignal>
#include <filesystem>
#include <fstream>
#include <string>

#include <gtest/gtest.h>
#include <sys/resource.h>

#include "tests/support/directory.hpp"

namespace rcb::launch {
namespace {

namespace fs = std::filesystem;
using testing::contents;

class Log : public testing::DirectoryTest {
 protected:
  const std::string path_ = at("rcbd.log");
};

TEST_F(Log, IsRotatedWhileItIsWritten) {
  constexpr std::uint64_t kMost = 10'000;
  ServiceLog log(path_, kMost);
  ASSERT_TRUE(log.open().ok());
  for (int i = 0; i < 2000; ++i) {
    log.add("line " + std::to_string(i) + " of the service\n");
    ASSERT_LE(fs::file_size(path_), kMost + 100);
  }
  EXPECT_LE(fs::file_size(path_ + ".1"), kMost + 100);
  EXPECT_FALSE(fs::exists(path_ + ".2"));
  EXPECT_EQ(log.tail().substr(log.tail().rfind('\n') + 1), "line 1999 of the service");
  const std::string both = contents(path_ + ".1") + contents(path_);
  EXPECT_NE(both.find("line 1999 "), std::string::npos);
  EXPECT_NE(both.find("line 1700 "), std::string::npos) << "the last ones are there without a gap";
}

TEST_F(Log, IsMadeAgainWhereItWasRemoved) {
  ServiceLog log(path_);
  ASSERT_TRUE(log.open().ok());
  log.add("before\n");
  fs::remove(path_);
  log.add("lost with the file\n");
  ASSERT_TRUE(log.refresh().ok());
  log.add("after\n");
  EXPECT_EQ(contents(path_), "after\n");
}

// A limit on the size of files stands for the full disk: writes fail in the same place.
TEST_F(Log, TellsWhatAFullDiskHasSwallowed) {
  std::signal(SIGXFSZ, SIG_IGN);
  rlimit before{};
  ASSERT_EQ(::getrlimit(RLIMIT_FSIZE, &before), 0);
  ServiceLog log(path_);
  ASSERT_TRUE(log.open().ok());
  log.add("before\n");
  rlimit full = before;
  full.rlim_cur = 7;
  ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &full), 0);
  log.add("twelve bytes\n");
  log.add("error: why it died\n");
  ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &before), 0);
  EXPECT_NE(log.tail().find("error: why it died"), std::string::npos) << "the reason needs no disk";
  log.add("after\n");
  const std::string text = contents(path_);
  EXPECT_EQ(text.substr(0, 7), "before\n");
  EXPECT_NE(text.find("32 bytes of the log are missing here"), std::string::npos) << text;
  EXPECT_NE(text.find("\nafter\n"), std::string::npos) << text;
}

TEST_F(Log, ANoteStandsOnALineOfItsOwnAndIsNoLastWordOfTheService) {
  ServiceLog log(path_);
  ASSERT_TRUE(log.open().ok());
  log.begin_job();
  log.add("error: half a li");
  log.note("the service died");
  EXPECT_NE(contents(path_).find("half a li\n"), std::string::npos);
  EXPECT_EQ(log.tail(), "error: half a li");
  log.begin_job();
  EXPECT_EQ(log.tail(), "");
}

TEST_F(Log, TakesNoLink) {
  std::ofstream(directory_ + "/precious") << "precious";
  fs::create_symlink(directory_ + "/precious", path_);
  ServiceLog log(path_);
  EXPECT_EQ(log.open().code(), Code::not_authorised);
  log.add("nowhere\n");
  EXPECT_EQ(contents(directory_ + "/precious"), "precious");
}

}  // namespace
}  // namespace rcb::launch
