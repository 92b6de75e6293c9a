// What another user has made, or could change, is no place for the files of a service.
#include "common/files/own_files.hpp"

#include <filesystem>
#include <fstream>
#include <iostream>
#include <string>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/files/paths.hpp"
#include "tests/support/directory.hpp"

namespace rcb {
namespace {

namespace fs = std::filesystem;

constexpr uid_t kStranger = 12345;

class OwnFiles : public testing::DirectoryTest {
 protected:
  std::string make(const std::string& name, mode_t mode, uid_t owner = ::geteuid()) const {
    EXPECT_EQ(::mkdir(at(name).c_str(), 0700), 0);
    EXPECT_EQ(::chmod(at(name).c_str(), mode), 0);
    if (owner != ::geteuid()) {
      EXPECT_EQ(::chown(at(name).c_str(), owner, owner), 0);
    }
    return at(name);
  }
  // A refusal that names the component.
  static void expect_refused(const Status& status, const std::string& component) {
    EXPECT_EQ(status.code(), Code::not_authorised) << status.message();
    EXPECT_NE(status.message().find(component), std::string::npos) << status.message();
    EXPECT_FALSE(status.hint().empty());
  }
};

#define NEEDS_ROOT()                                                           \
  if (::geteuid() != 0) {                                                      \
    std::cerr << "SKIPPED: only root can make what belongs to another user\n"; \
    GTEST_SKIP();                                                              \
  }

TEST_F(OwnFiles, MissingDirectoriesAreMadePrivate) {
  ASSERT_TRUE(make_own_directory(at("a/b")).ok());
  for (const char* name : {"a", "a/b"}) {
    EXPECT_EQ(testing::mode_of(at(name)), 0700U) << name;
  }
  EXPECT_TRUE(make_own_directory(at("a/../a/./b")).ok());
  std::ofstream(at("file")) << "x";
  EXPECT_EQ(make_own_directory(at("file")).code(), Code::io_error);
  EXPECT_EQ(make_own_directory(at("file/below")).code(), Code::io_error);
}

TEST_F(OwnFiles, AnOwnLinkIsFollowedATurningOneIsNot) {
  make("real", 0700);
  fs::create_directory_symlink("real", at("link"));
  EXPECT_TRUE(make_own_directory(at("link/below")).ok());
  EXPECT_TRUE(fs::is_directory(at("real/below")));
  fs::create_directory_symlink("round", at("round"));
  EXPECT_EQ(make_own_directory(at("round")).code(), Code::io_error);
}

TEST_F(OwnFiles, WhatOthersMayWriteIsRefused) {
  make("open", 0777);
  expect_refused(make_own_directory(at("open")), at("open"));
  expect_refused(make_own_directory(at("open/below")), at("open"));
  EXPECT_FALSE(fs::exists(at("open/below")));
  // In a sticky one only the owner can replace what is the owner's.
  make("sticky", 01777);
  EXPECT_TRUE(make_own_directory(at("sticky/mine")).ok());
  EXPECT_TRUE(check_parent_directory(at("sticky")).ok());
  expect_refused(make_own_directory(at("sticky")), at("sticky"));
}

TEST_F(OwnFiles, WhatAnotherUserHasMadeIsRefused) {
  NEEDS_ROOT();
  make("theirs", 0755, kStranger);
  expect_refused(make_own_directory(at("theirs")), at("theirs"));
  expect_refused(make_own_directory(at("theirs/data")), at("theirs"));
  EXPECT_FALSE(fs::exists(at("theirs/data")));
  expect_refused(check_parent_directory(at("theirs")), at("theirs"));
  // Inside of it one of ours, as if it had been made before: its parent can still be moved away.
  ASSERT_EQ(::mkdir(at("theirs/ours").c_str(), 0700), 0);
  expect_refused(make_own_directory(at("theirs/ours")), at("theirs"));
  make("sticky", 01777);
  make("sticky/theirs", 0755, kStranger);
  expect_refused(make_own_directory(at("sticky/theirs/data")), at("sticky/theirs"));
  make("ours", 0700);
  fs::create_directory_symlink(at("ours"), at("sticky/link"));
  ASSERT_EQ(::lchown(at("sticky/link").c_str(), kStranger, kStranger), 0);
  expect_refused(make_own_directory(at("sticky/link/data")), at("sticky/link"));
}

TEST_F(OwnFiles, OnlyARegularFileWithOneNameIsOpened) {
  const auto append = [](const std::string& path) {
    return open_own_file(path, O_WRONLY | O_CREAT | O_APPEND).status();
  };
  EXPECT_TRUE(append(at("new")).ok());
  EXPECT_TRUE(append(at("new")).ok());
  std::ofstream(at("precious")) << "precious";
  fs::create_symlink(at("precious"), at("link"));
  expect_refused(append(at("link")), at("link"));
  fs::create_symlink(at("nowhere"), at("dangling"));
  expect_refused(append(at("dangling")), at("dangling"));
  EXPECT_FALSE(fs::exists(at("nowhere")));
  fs::create_hard_link(at("precious"), at("second"));
  expect_refused(append(at("second")), at("second"));
  ASSERT_EQ(::mkfifo(at("fifo").c_str(), 0600), 0);
  expect_refused(append(at("fifo")), at("fifo"));  // and nobody waits for its reader
  make("directory", 0700);
  expect_refused(append(at("directory")), at("directory"));
  std::ofstream(at("open")) << "x";
  ASSERT_EQ(::chmod(at("open").c_str(), 0666), 0);
  expect_refused(append(at("open")), at("open"));
  EXPECT_EQ(open_own_file(at("none"), O_RDONLY).status().code(), Code::not_found);
  EXPECT_EQ(fs::file_size(at("precious")), 8U);
  if (::geteuid() != 0) return;
  std::ofstream(at("theirs")) << "x";
  ASSERT_EQ(::chown(at("theirs").c_str(), kStranger, kStranger), 0);
  expect_refused(append(at("theirs")), at("theirs"));
}

}  // namespace
}  // namespace rcb
