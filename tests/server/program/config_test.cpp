// rcbd's command line and environment.
#include "server/program/config.hpp"

#include <cstdlib>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "tests/support/directory.hpp"
#include "tests/support/variable.hpp"

namespace rcb::server {
namespace {

ParsedConfig parse(std::vector<const char*> arguments) {
  arguments.insert(arguments.begin(), "rcbd");
  return parse_config(static_cast<int>(arguments.size()), arguments.data());
}

using testing::Variable;

TEST(Config, AloneItListensOnTheDefaultSocketAndTakesFilesBelowItsFolder) {
  const ParsedConfig parsed = parse({});
  ASSERT_TRUE(parsed.run) << parsed.error;
  EXPECT_EQ(parsed.config.endpoint(), "unix:" + parsed.config.socket);
  EXPECT_TRUE(parsed.config.socket.ends_with("rcbd.sock")) << parsed.config.socket;
  EXPECT_EQ(parsed.config.local_files_below, std::vector<std::string>{"."});
  EXPECT_TRUE(parsed.config.files_below.empty());
}

TEST(Config, OverTcpAloneThereAreNoFiles) {
  const ParsedConfig parsed = parse({"--listen", "127.0.0.1:7470"});
  ASSERT_TRUE(parsed.run) << parsed.error;
  EXPECT_EQ(parsed.config.endpoint(), "127.0.0.1:7470");
  EXPECT_TRUE(parsed.config.local_files_below.empty());
  EXPECT_TRUE(parsed.config.files_below.empty());
}

TEST(Config, FlagsWinOverTheEnvironment) {
  const Variable level("RCBD_LOG_LEVEL", "warn");
  const Variable keep("RCBD_KEEP_REPORTS", "77");
  const Variable folders("RCBD_FILES_BELOW", "/a::/b");
  const ParsedConfig parsed = parse({"--log-level", "debug"});
  ASSERT_TRUE(parsed.run) << parsed.error;
  EXPECT_EQ(parsed.config.log_level, "debug");
  EXPECT_EQ(parsed.config.keep_reports, 77U);
  EXPECT_EQ(parsed.config.files_below, (std::vector<std::string>{"/a", "/b"}));
}

TEST(Config, SizesHaveUnitsAndABound) {
  EXPECT_EQ(parse({"--bulk-bytes", "2mb"}).config.bulk_bytes, std::uint64_t{2} << 20U);
  for (const char* wrong : {"-1", "0", "99999tb", "1.5gb", "many"}) {
    const ParsedConfig parsed = parse({"--bulk-bytes", wrong});
    EXPECT_FALSE(parsed.run) << wrong;
    EXPECT_EQ(parsed.exit_code, 2) << wrong;
    EXPECT_NE(parsed.error.find("--bulk-bytes"), std::string::npos) << parsed.error;
  }
}

TEST(Config, WhatIsWrongIsToldAndEndsIt) {
  for (const std::vector<const char*>& wrong : std::vector<std::vector<const char*>>{{"--silence-seconds", "1"},
                                                                                     {"--stall-seconds", "0"},
                                                                                     {"--keep-reports", "0"},
                                                                                     {"--log-level", "loud"},
                                                                                     {"--no-skip", "nothing"},
                                                                                     {"--unknown"},
                                                                                     {"word"}}) {
    const ParsedConfig parsed = parse(wrong);
    EXPECT_FALSE(parsed.run) << wrong[0];
    EXPECT_EQ(parsed.exit_code, 2) << wrong[0];
    EXPECT_FALSE(parsed.error.empty()) << wrong[0];
  }
}

TEST(Config, WhatAFileHasThatIsNoOptionIsRefused) {
  const testing::Directory directory;
  const std::string file = directory.write("rcbd.conf", "log-level = warn\n");
  EXPECT_EQ(parse({"--config", file.c_str()}).config.log_level, "warn");
  directory.write("rcbd.conf", "scoket = /tmp/elsewhere.sock\n");
  const ParsedConfig parsed = parse({"--config", file.c_str()});
  EXPECT_FALSE(parsed.run);
  EXPECT_EQ(parsed.exit_code, 2);
  EXPECT_NE(parsed.error.find("scoket"), std::string::npos) << parsed.error;
  directory.write("rcbd.conf", "a\033[31m" + std::string(100000, 'a') + " = 1\n");
  const std::string error = parse({"--config", file.c_str()}).error;
  EXPECT_NE(error.find("a\\x1b[31m"), std::string::npos) << error;
  EXPECT_LT(error.size(), 300U);
}

TEST(Config, InstructionsThatAreUnknownAreRefused) {
  const Variable cpu("RCBD_CPU", "baselin");
  const ParsedConfig parsed = parse({});
  EXPECT_FALSE(parsed.run);
  EXPECT_NE(parsed.error.find("RCBD_CPU"), std::string::npos) << parsed.error;
}

TEST(Config, HelpIsNoError) {
  const ParsedConfig parsed = parse({"--help"});
  EXPECT_FALSE(parsed.run);
  EXPECT_EQ(parsed.exit_code, 0);
  EXPECT_NE(parsed.out.find("mpirun"), std::string::npos);
}

}  // namespace
}  // namespace rcb::server
