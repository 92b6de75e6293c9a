// The supervisor with the real rcbd, and pauses that a test can wait for.
#include "client/launch/supervisor.hpp"

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "client/launch/job/processes.hpp"
#include "client/launch/job/programs.hpp"
#include "client/launch/launch.hpp"
#include "client/launch/probe.hpp"
#include "client/launch/reach.hpp"
#include "common/files/endpoint_lock.hpp"
#include "tests/support/directory.hpp"
#include "tests/support/wait.hpp"

namespace rcb::launch {
namespace {

namespace fs = std::filesystem;
using testing::eventually;

class Supervised : public testing::DirectoryTest {
 protected:
  void SetUp() override {
    const auto rcbd = find_rcbd();
    ASSERT_TRUE(rcbd.ok()) << rcbd.status().message();
    // Ends at once as long as there is the file `broken`.
    fs::create_directories(folder_ / "bin");
    std::ofstream(folder_ / "bin" / "rcbd")
        << fmt::format("#!/bin/sh\n[ -e {} ] && {{ echo 'error: the moon is wrong' >&2; exit 3; }}\nexec {} \"$@\"\n",
                       (folder_ / "broken").string(), *rcbd);
    fs::permissions(folder_ / "bin" / "rcbd", fs::perms::owner_all);
    setenv("RCBD_BIN_DIR", (folder_ / "bin").c_str(), 1);
    options_.endpoint = "unix:" + (folder_ / "s").string();
    options_.data_dir = (folder_ / "data").string();
    options_.pause_first_seconds = 0.01;
    options_.pause_most_seconds = 0.1;
    options_.ask_seconds = 0.2;
    options_.silence_seconds = 1;
  }
  void TearDown() override {
    (void)stop_service(options_.endpoint, 20);
    unsetenv("RCBD_BIN_DIR");
  }
  EndpointNote note() const { return endpoint_holder(options_.endpoint).value_or(EndpointNote{}); }
  pid_t rank0() const {
    auto client = reach(options_.endpoint, "test", 1);
    return client.ok() ? rank0_of(*client, 1).pid : -1;
  }

  const fs::path folder_ = directory_;
  SuperviseOptions options_;
};

TEST_F(Supervised, NeverGivesUpAndSaysWhatItDoes) {
  ASSERT_TRUE(start_detached(options_, {}).ok());
  const pid_t first = rank0();
  ASSERT_GT(first, 0);
  std::ofstream(folder_ / "broken") << "";
  kill(first, SIGKILL);
  ASSERT_TRUE(eventually([&] { return note().failures >= 12; })) << note().text();
  EXPECT_NE(note().last_reason.find("the moon is wrong"), std::string::npos) << note().last_reason;
  fs::remove(folder_ / "broken");
  ASSERT_TRUE(eventually([&] { return rank0() > 0; }));
  EXPECT_NE(rank0(), first);
  EXPECT_TRUE(eventually([&] { return note().start_at_unix == 0; }));
  const auto stopped = stop_service(options_.endpoint, 20);
  ASSERT_TRUE(stopped.ok()) << stopped.status().message();
  EXPECT_FALSE(endpoint_holder(options_.endpoint));
}

TEST_F(Supervised, AServiceThatLivesLongEnoughEndsARowOfFailures) {
  options_.backoff_reset_seconds = 0.1;
  ASSERT_TRUE(start_detached(options_, {}).ok());
  for (int death = 1; death <= 3; ++death) {
    const pid_t victim = rank0();
    ASSERT_GT(victim, 0);
    usleep(1'000'000);  // asked at least once since
    kill(victim, SIGKILL);
    ASSERT_TRUE(eventually([&] { return note().deaths == death && note().start_at_unix == 0 && rank0() > 0; }))
        << note().text();
    EXPECT_EQ(note().failures, 1);
  }
}

TEST_F(Supervised, AStartThatIsToldToEndSaysSo) {
  std::ofstream(folder_ / "bin" / "rcbd") << "#!/bin/sh\nexec sleep 1000\n";
  const pid_t child = fork();
  if (child == 0) {
    const Status status = start_detached(options_, {});
    _exit(status.message() == "the service was told to end while it started" ? 0 : 1);
  }
  ASSERT_TRUE(eventually([&] { return note().process.exists(); }));
  const auto stopped = stop_service(options_.endpoint, 20);
  EXPECT_TRUE(stopped.ok()) << stopped.status().message();
  int status = 0;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  EXPECT_EQ(WEXITSTATUS(status), 0);
}

TEST_F(Supervised, AnotherWhoAnswersIsNotTakenForTheJob) {
  std::ofstream(folder_ / "bin" / "rcbd") << "#!/bin/sh\nexec sleep 1000\n";
  // Someone who answers on the port that the job is about to take.
  unsetenv("RCBD_BIN_DIR");
  SuperviseOptions other = options_;
  other.endpoint = "127.0.0.1:17493";
  other.data_dir += "2";
  ASSERT_TRUE(start_detached(other, {}).ok());
  setenv("RCBD_BIN_DIR", (folder_ / "bin").c_str(), 1);
  SuperviseOptions late = options_;
  late.endpoint = "localhost:17493";  // another name, so no lock of this user's tells
  late.ready_seconds = 1;
  EXPECT_EQ(start_detached(late, {}).code(), Code::deadline_exceeded);
  EXPECT_TRUE(stop_service(other.endpoint, 20).ok());
}

bool all_threads_stopped(pid_t process) {
  for (const auto& thread : std::filesystem::directory_iterator(fmt::format("/proc/{}/task", process))) {
    const std::string line = testing::contents(thread.path() / "stat");
    if (line.substr(line.rfind(')') + 1, 2) != " T") return false;
  }
  return true;
}

TEST_F(Supervised, OneThatRefusesEverybodyLives) {
  options_.service_arguments = {};
  ASSERT_TRUE(start_detached(options_, {}).ok());
  std::string why;
  EXPECT_EQ(ask(options_.endpoint, 5, why), Answer::heard) << why;
  const pid_t rank = rank0();
  kill(rank, SIGSTOP);
  while (!all_threads_stopped(rank)) usleep(1000);
  EXPECT_EQ(ask(options_.endpoint, 0.2, why), Answer::silent) << "the kernel takes the connection, the service doesn't";
  kill(rank, SIGCONT);
  EXPECT_EQ(ask(options_.endpoint, 5, why), Answer::heard) << why;
  EXPECT_EQ(ask("unix:" + (folder_ / "none").string(), 5, why), Answer::silent);
  EXPECT_EQ(ask("127.0.0.1:1", 5, why), Answer::silent);
  EXPECT_EQ(why, "");
}

TEST(Ask, WhatCannotBeAskedIsNotCalledSilent) {
  std::string why;
  EXPECT_EQ(ask("name.invalid:1", 5, why), Answer::unasked);
  EXPECT_NE(why, "");
  EXPECT_EQ(ask("unix:/proc/self/exe/s", 5, why), Answer::unasked);
  EXPECT_EQ(why, "Not a directory");
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &before), 0);
  const rlimit none{0, before.rlim_max};
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &none), 0);
  const Answer answer = ask("127.0.0.1:1", 5, why);
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &before), 0);
  EXPECT_EQ(answer, Answer::unasked);
  EXPECT_EQ(why, "Too many open files");
}

}  // namespace
}  // namespace rcb::launch
