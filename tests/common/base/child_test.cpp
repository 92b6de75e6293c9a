// How a child has ended is known, whatever whoever started this process has left it.
#include "common/base/child.hpp"

#include <csignal>

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

namespace rcb {
namespace {

TEST(Child, HowItEndedIsKnownThoughTheStarterIgnoresItsChildren) {
  std::signal(SIGCHLD, SIG_IGN);
  keep_ended_children();
  const pid_t child = ::fork();
  if (child == 0) ::_exit(7);
  const auto status = wait_or_kill(child, 60);
  ASSERT_TRUE(status);
  ASSERT_TRUE(WIFEXITED(*status));
  EXPECT_EQ(WEXITSTATUS(*status), 7);
}

}  // namespace
}  // namespace rcb
