// load and write_parts: only below the roots, on all ranks or on none.
#include <cstdlib>
#include <filesystem>
#include <fstream>

#include <gtest/gtest.h>

#include "common/io/files/roots.hpp"
#include "tests/server/service/driver.hpp"
#include "tests/support/on_ranks.hpp"

namespace rcb::testing {
namespace {

namespace fs = std::filesystem;
using service::Service;

// A folder for clients' files, and one beside it.
class FilesTest : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!ranks_are_threads()) GTEST_SKIP() << "the folders are of one process";
    std::string name = (fs::temp_directory_path() / "rcb-files-XXXXXX").string();
    ASSERT_NE(::mkdtemp(name.data()), nullptr);
    base_ = name;
    fs::create_directories(base_ / "root");
    fs::create_directories(base_ / "outside");
    std::ofstream(base_ / "root/points.csv") << "0,0,0\n1,1,1\n2,2,2\n3,3,3\n";
    std::ofstream(base_ / "outside/points.csv") << "0,0,0\n1,1,1\n";
    std::ofstream(base_ / "root/word.csv") << "1,2,3\n1,hunter2,3\n";
    fs::create_symlink("../outside", base_ / "root/out");
    ASSERT_TRUE(roots_.add((base_ / "root").string()).ok());
  }
  void TearDown() override {
    std::error_code ignored;
    if (!base_.empty()) fs::remove_all(base_, ignored);
  }
  std::string at(const char* name) const { return (base_ / name).string(); }
  bool outside_is_as_it_was() const {
    return std::distance(fs::directory_iterator(base_ / "outside"), fs::directory_iterator()) == 1;
  }

  fs::path base_;
  io::Roots roots_;
};

TEST_F(FilesTest, OnlyBelowTheRoots) {
  on_ranks([&](comm::Comm& comm) {
    Service service(comm, kClock, {.roots = &roots_});
    Driver driver(comm, service, "s");
    driver.create({{"parts", 3}});
    const auto expect = [&](const char* command, const Json& arguments, Code code) {
      const Response response = driver.ask(command, arguments);
      if (comm.rank() == 0) {
        EXPECT_EQ(response.status.code(), code) << command << " " << arguments << ": " << response.status.message();
        EXPECT_EQ(response.status.message().find("hunter2"), std::string::npos) << response.status.message();
      }
    };
    for (const char* name : {"outside/points.csv", "root/out/points.csv", "root/../outside/points.csv"})
      expect("load", {{"path", at(name)}}, Code::not_authorised);
    expect("load", {{"path", "/etc/shadow"}}, Code::not_authorised);
    expect("load", {{"path", at("root/word.csv")}}, Code::invalid_argument);
    expect("load", {{"path", at("root/points.csv")}, {"step", wire::kStepMax + 1}}, Code::invalid_argument);
    expect("load", {{"path", at("root/points.csv")}, {"step", wire::kStepMax}}, Code::ok);
    for (const char* name : {"outside", "root/out", "root/out/new", "root/../outside"})
      expect("write_parts", {{"directory", at(name)}}, Code::not_authorised);
    for (const char* prefix : {"", ".", "..", "a/b", "../x", "two\nlines", "\x1b[2J", "\u009b2J"})
      expect("write_parts", {{"directory", at("root")}, {"prefix", prefix}}, Code::invalid_argument);
    expect("write_parts", {{"directory", at("root")}, {"prefix", std::string(65, 'p')}}, Code::invalid_argument);
    expect("write_parts", {{"directory", at("root/new")}, {"prefix", "größe 1"}}, Code::ok);
    expect("write_parts", {{"directory", at("root/new")}}, Code::ok);
    if (comm.rank() == 0) {
      EXPECT_TRUE(fs::exists(base_ / "root/new/größe 1-2.csv"));
      EXPECT_TRUE(fs::exists(base_ / "root/new/part-0.csv"));
      EXPECT_TRUE(outside_is_as_it_was());
    }
    comm.barrier();
  });
}

TEST_F(FilesTest, AServiceWithoutRootsOpensNothing) {
  on_ranks({2}, [&](comm::Comm& comm) {
    Service service(comm, kClock);
    Driver driver(comm, service, "s");
    driver.create({{"parts", 2}});
    const Response response = driver.ask("load", {{"path", at("root/points.csv")}});
    if (comm.rank() == 0) {
      EXPECT_EQ(response.status.code(), Code::not_authorised);
    }
  });
}

// One rank that may not is enough.
TEST_F(FilesTest, AllRanksOrNone) {
  on_ranks({4}, [&](comm::Comm& comm) {
    const io::Roots none;
    Service service(comm, kClock, {.roots = comm.rank() == 2 ? &none : &roots_});
    Driver driver(comm, service, "s");
    driver.create({{"parts", 4}});
    const Response loaded = driver.ask("load", {{"path", at("root/points.csv")}});
    driver.push(random_particles(5, 40, 3), 0);
    const Response written = driver.ask("write_parts", {{"directory", at("root/parts")}});
    if (comm.rank() == 0) {
      EXPECT_EQ(loaded.status.code(), Code::not_authorised);
      EXPECT_EQ(written.status.code(), Code::not_authorised);
      EXPECT_TRUE(!fs::exists(base_ / "root/parts") || fs::is_empty(base_ / "root/parts"));
    }
  });
}

}  // namespace
}  // namespace rcb::testing
