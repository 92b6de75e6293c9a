// load and write_parts: only below the roots, on all ranks or on none.
#include <cerrno>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <future>
#include <set>
#include <system_error>
#include <thread>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "common/io/files/roots.hpp"
#include "tests/server/service/driver.hpp"
#include "tests/support/directory.hpp"
#include "tests/support/on_ranks.hpp"

namespace rcb::testing {
namespace {

namespace fs = std::filesystem;

// A folder for clients' files, and one beside it.
class FilesTest : public DirectoryTest {
 protected:
  void SetUp() override {
    if (!ranks_are_threads()) GTEST_SKIP() << "the folders are of one process";
    fs::create_directories(base_ / "root");
    fs::create_directories(base_ / "outside");
    std::ofstream(base_ / "root/points.csv") << "0,0,0\n1,1,1\n2,2,2\n3,3,3\n";
    std::ofstream(base_ / "outside/points.csv") << "0,0,0\n1,1,1\n";
    std::ofstream(base_ / "root/word.csv") << "1,2,3\n1,hunter2,3\n";
    fs::create_symlink("../outside", base_ / "root/out");
    ASSERT_TRUE(roots_->add((base_ / "root").string()).ok());
  }
  bool outside_is_as_it_was() const {
    return std::distance(fs::directory_iterator(base_ / "outside"), fs::directory_iterator()) == 1;
  }

  const fs::path base_ = directory_;
  std::shared_ptr<io::Roots> roots_ = std::make_shared<io::Roots>();
};

TEST_F(FilesTest, OnlyBelowTheRoots) {
  on_ranks([&](comm::Comm& comm) {
    OwnDriver driver(comm, "s", {{"parts", 3}}, {.roots = roots_});
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
    OwnDriver driver(comm, "s", {{"parts", 2}});
    const Response response = driver.ask("load", {{"path", at("root/points.csv")}});
    if (comm.rank() == 0) {
      EXPECT_EQ(response.status.code(), Code::not_authorised);
    }
  });
}

// One rank that may not is enough.
TEST_F(FilesTest, AllRanksOrNone) {
  on_ranks({4}, [&](comm::Comm& comm) {
    const auto none = std::make_shared<io::Roots>();
    OwnDriver driver(comm, "s", {{"parts", 4}}, {.roots = comm.rank() == 2 ? none : roots_});
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

// On one of the ranks the system gives no thread for files.
TEST_F(FilesTest, WithoutAThreadACommandFailsAndNothingElse) {
  on_ranks({3}, [&](comm::Comm& comm) {
    const auto none = [](const SideThread::Job&) -> std::thread {
      throw std::system_error(EAGAIN, std::generic_category());
    };
    Service service(comm, kClock,
                    {.roots = roots_, .start_thread = comm.rank() == 1 ? SideThread::Start(none) : nullptr});
    Driver driver(comm, service, "s");
    driver.create({{"parts", 4}});
    const Response loaded = driver.ask("load", {{"path", at("root/points.csv")}});
    driver.push(random_particles(5, 40, 3), 0);
    const Response written = driver.ask("write_parts", {{"directory", at("root/parts")}});
    const Response counts = driver.ask("counts");
    if (comm.rank() != 0) return;
    EXPECT_EQ(loaded.status.code(), Code::unavailable);
    EXPECT_EQ(written.status.code(), Code::unavailable);
    EXPECT_NE(written.status.hint().find("limit"), std::string::npos) << written.status.hint();
    EXPECT_TRUE(counts.status.ok());
  });
}

// Orders of other scenes, which a command gives way to: here they end the disk's standstill.
class OrdersBehind final : public service::WaitingOrders {
 public:
  explicit OrdersBehind(std::function<void()> execute) : execute_(std::move(execute)) {}
  std::uint64_t newest() override { return 1; }
  void execute(std::uint64_t newest) override {
    if (newest > 0) execute_();
  }

 private:
  std::function<void()> execute_;
};

TEST_F(FilesTest, ADiskThatStandsStillHoldsUpTheCommandAlone) {
  for (const std::string command : {"load", "write_parts"}) {
    SCOPED_TRACE(command);
    std::promise<void> moves;
    const std::shared_future<void> moved = moves.get_future().share();
    on_ranks({2}, [&](comm::Comm& comm) {
      // The thread of one rank stands still before its first job.
      const auto start = [moved, still = comm.rank() == 1](SideThread::Job run) {
        return std::thread([moved, still, run = std::move(run)] {
          if (still) moved.wait();
          run();
        });
      };
      OwnDriver driver(comm, "s", {{"parts", 4}}, {.roots = roots_, .start_thread = start});
      if (command == "write_parts") driver.push(random_particles(5, 40, 3), 0);
      Json request{
          {"command", command}, {"scene", "s"}, {"path", at("root/points.csv")}, {"directory", at("root/new")}};
      const Response late = driver.service.execute(request, {}, {.seconds_left = 0.1});
      const Response counts = driver.ask("scene.show");
      int given_way = 0;
      OrdersBehind behind([&] {
        if (++given_way == 3 && comm.rank() == 0) moves.set_value();
      });
      const Response whole = driver.service.execute(request, {}, {.seconds_left = 60, .waiting = &behind});
      if (comm.rank() != 0) return;
      EXPECT_EQ(late.status.code(), Code::deadline_exceeded);
      EXPECT_TRUE(counts.status.ok());
      EXPECT_TRUE(whole.status.ok()) << whole.status.message();
      EXPECT_GE(given_way, 3);
    });
  }
}

TEST_F(FilesTest, PartsOfManyPiecesAreWhole) {
  on_ranks({2}, [&](comm::Comm& comm) {
    Service service(comm, kClock, {.roots = roots_});
    Driver driver(comm, service, "s");
    constexpr std::size_t kCount = 300'000;
    driver.create({{"parts", 3}});
    driver.push(random_particles(5, kCount, 3), 0);
    const Response written = driver.ask("write_parts", {{"directory", at("root/parts")}});
    if (comm.rank() != 0) return;
    ASSERT_TRUE(written.status.ok()) << written.status.message();
    std::set<std::int64_t> ids;
    for (int part = 0; part < 3; ++part) {
      std::ifstream file(base_ / fmt::format("root/parts/part-{}.csv", part));
      std::string line;
      std::getline(file, line);
      EXPECT_EQ(line, "x,y,z,id");
      std::size_t lines = 0;
      for (; std::getline(file, line); ++lines) ids.insert(std::stoll(line.substr(line.rfind(',') + 1)));
      EXPECT_EQ(lines, kCount / 3);
    }
    EXPECT_EQ(ids.size(), kCount);
    EXPECT_EQ(std::distance(fs::directory_iterator(base_ / "root/parts"), fs::directory_iterator()), 3);
  });
}

}  // namespace
}  // namespace rcb::testing
