// Endpoints never share a data directory, and private directories are private.
#include "common/files/paths.hpp"

#include <cstdlib>
#include <filesystem>
#include <map>
#include <string>

#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

namespace rcb {
namespace {

class Paths : public testing::Test {
 protected:
  void SetUp() override {
    std::string name = (std::filesystem::temp_directory_path() / "rcb-paths-XXXXXX").string();
    ASSERT_NE(::mkdtemp(name.data()), nullptr);
    directory_ = name;
    for (const char* variable : {"XDG_RUNTIME_DIR", "XDG_STATE_HOME", "HOME"}) {
      if (const char* value = std::getenv(variable)) saved_[variable] = value;
    }
  }
  void TearDown() override {
    for (const char* variable : {"XDG_RUNTIME_DIR", "XDG_STATE_HOME", "HOME"}) {
      ::unsetenv(variable);
      if (saved_.count(variable) != 0) ::setenv(variable, saved_[variable].c_str(), 1);
    }
    std::filesystem::remove_all(directory_);
  }
  std::string directory_;
  std::map<std::string, std::string> saved_;
};

mode_t mode_of(const std::string& path) {
  struct stat about {};
  EXPECT_EQ(::stat(path.c_str(), &about), 0) << path;
  return about.st_mode & 0777U;
}

TEST_F(Paths, DefaultSocketFollowsTheEnvironment) {
  ::setenv("XDG_RUNTIME_DIR", "/run/user/7", 1);
  EXPECT_EQ(default_socket_path(), "/run/user/7/rcbd/rcbd.sock");
  const std::string fallback = "/tmp/rcbd-" + std::to_string(::getuid()) + "/rcbd.sock";
  ::unsetenv("XDG_RUNTIME_DIR");
  EXPECT_EQ(default_socket_path(), fallback);
  ::setenv("XDG_RUNTIME_DIR", "relative", 1);
  EXPECT_EQ(default_socket_path(), fallback);
}

TEST_F(Paths, EachEndpointHasItsOwnDataDirectory) {
  ::setenv("XDG_STATE_HOME", directory_.c_str(), 1);
  std::map<std::string, std::string> seen;
  for (const char* endpoint :
       {"unix:/a/b", "unix:/a_b", "unix:/a%2Fb", "unix:/a-b", "unix:/a.b", "h:1", "h_1", "h%3A1", "h:11"}) {
    const std::string data = data_directory_for(endpoint);
    EXPECT_EQ(data.rfind(directory_ + "/rcbd/", 0), 0U) << data;
    EXPECT_EQ(data.find('/', directory_.size() + 6), std::string::npos) << data;
    EXPECT_TRUE(seen.emplace(data, endpoint).second) << endpoint << " and " << seen[data];
  }
  EXPECT_EQ(data_directory_for("/a/b"), data_directory_for("unix:/a/b"));
  ::unsetenv("XDG_STATE_HOME");
  ::setenv("HOME", "/home/someone", 1);
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
