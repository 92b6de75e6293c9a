// A rank that fails ends, whatever its memory and its output are like.
#include "server/program/job.hpp"

#include <array>
#include <csignal>
#include <cstdlib>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <unistd.h>

namespace rcb::server {
namespace {

TEST(EndAtFaultsDeathTest, TellsRankAndSignalAndWhere) {
  const auto fail = [](int number) {
    end_at_faults(3);
    ::raise(number);
  };
  EXPECT_EXIT(fail(SIGSEGV), ::testing::KilledBySignal(SIGSEGV), "rank 3 .pid [0-9]+.: signal 11; it ends\n.*test_");
  EXPECT_EXIT(fail(SIGABRT), ::testing::KilledBySignal(SIGABRT), "rank 3 .pid [0-9]+.: signal 06; it ends");
}

TEST(EndAtFaultsDeathTest, EndsThoughNobodyReadsWhatItSays) {
  const auto fail = [] {
    std::array<int, 2> ends{};
    if (::pipe2(ends.data(), O_NONBLOCK) != 0) return;
    while (::write(ends[1], "full", 4) > 0) {
    }
    ::fcntl(ends[1], F_SETFL, 0);
    ::dup2(ends[1], STDERR_FILENO);
    end_at_faults(3);
    std::abort();
  };
  EXPECT_EXIT(fail(), ::testing::KilledBySignal(SIGALRM), "");
}

}  // namespace
}  // namespace rcb::server
