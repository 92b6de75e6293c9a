// Endpoints never share a data directory, and private directories are private.
#include "common/files/paths.hpp"

#include <cstdlib>
#include <filesystem>
#include <map>
#include <string>

#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include "tests/support/directory.hpp"
#include "tests/support/variable.hpp"

namespace rcb {
namespace {

class Paths : public testing::DirectoryTest {
 protected:
  const testing::Variable run_{"XDG_RUNTIME_DIR", std::getenv("XDG_RUNTIME_DIR")};
  const testing::Variable state_{"XDG_STATE_HOME", std::getenv("XDG_STATE_HOME")};
  const testing::Variable home_{"HOME", std::getenv("HOME")};
};

using testing::mode_of;

TEST_F(Paths, DefaultSocketFollowsTheEnvironment) {
  run_.set(directory_.c_str());
  EXPECT_EQ(default_socket_path(), directory_ + "/rcbd/rcbd.sock");
  std::filesystem::create_directory(directory_ + "/another's");
  const bool root = ::chown((directory_ + "/another's").c_str(), 12345, 12345) == 0;
  const std::string fallback = "/tmp/rcbd-" + std::to_string(::getuid()) + "/rcbd.sock";
  // As batch systems and su hand it on: not there, no folder, another user's.
  for (const std::string& runtime : {std::string("relative"), directory_ + "/absent", std::string("/proc/self/comm"),
                                     root ? directory_ + "/another's" : std::string("/")}) {
    run_.set(runtime.c_str());
    EXPECT_EQ(default_socket_path(), fallback) << runtime;
  }
  run_.set(nullptr);
  EXPECT_EQ(default_socket_path(), fallback);
}

TEST_F(Paths, EachEndpointHasItsOwnDataDirectory) {
  state_.set(directory_.c_str());
  std::map<std::string, std::string> seen;
  for (const char* endpoint :
       {"unix:/a/b", "unix:/a_b", "unix:/a%2Fb", "unix:/a-b", "unix:/a.b", "h:1", "h_1", "h%3A1", "h:11"}) {
    const std::string data = data_directory_for(endpoint);
    EXPECT_EQ(data.rfind(directory_ + "/rcbd/", 0), 0U) << data;
    EXPECT_EQ(data.find('/', directory_.size() + 6), std::string::npos) << data;
    EXPECT_TRUE(seen.emplace(data, endpoint).second) << endpoint << " and " << seen[data];
  }
  EXPECT_EQ(data_directory_for("/a/b"), data_directory_for("unix:/a/b"));
  state_.set(nullptr);
  home_.set("/home/someone");
  EXPECT_EQ(data_directory_for("h:1").rfind("/home/someone/.local/state/rcbd/", 0), 0U);
}

TEST_F(Paths, PrivateDirectoriesAre) {
  const std::string made = directory_ + "/one/two";
  ASSERT_TRUE(make_private_directory(made).ok());
  EXPECT_EQ(mode_of(made), 0700U);
  ASSERT_EQ(::chmod(made.c_str(), 0755), 0);
  ASSERT_TRUE(make_private_directory(made).ok());
  EXPECT_EQ(mode_of(made), 0700U);
  std::filesystem::create_directory_symlink(made, directory_ + "/link");
  EXPECT_FALSE(make_private_directory(directory_ + "/link").ok());
  std::filesystem::copy_file("/proc/self/comm", directory_ + "/file",
                             std::filesystem::copy_options::overwrite_existing);
  EXPECT_FALSE(make_private_directory(directory_ + "/file").ok());
  EXPECT_TRUE(make_directory(made).ok());
  EXPECT_EQ(join_path("a", "b"), "a/b");
}

}  // namespace
}  // namespace rcb
