// FileWork: whoever waits for a job hears of its end, however it ends.
#include "server/service/commands/file_work.hpp"

#include <stdexcept>

#include <gtest/gtest.h>

#include "tests/support/wait.hpp"

namespace rcb::service {
namespace {

TEST(FileWork, AJobThatThrowsHasFailed) {
  SideThread thread(1024);
  FileWork work(thread);
  work.run([]() -> Status { throw std::runtime_error("a bug"); });
  for (int moments = 0; work.unfinished() > 0 && moments < 50 * rcb::testing::kWaitSeconds; ++moments) work.wait(0);
  EXPECT_EQ(work.unfinished(), 0);
  EXPECT_EQ(work.status().code(), Code::internal);
  EXPECT_NE(work.status().message().find("a bug"), std::string::npos) << work.status().message();
}

}  // namespace
}  // namespace rcb::service
