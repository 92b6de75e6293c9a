// Whether a batch job has this machine.
#include "client/launch/job/programs.hpp"

#include <cstdlib>
#include <string>

#include <gtest/gtest.h>

#include "common/files/paths.hpp"
#include "tests/support/variable.hpp"

namespace rcb::launch {
namespace {

TEST(Programs, MachinesOfASlurmJob) {
  const char* const list = "login,a[01-03,7,8-12],b[1-2]x[3-4],c";
  for (const char* machine : {"login", "a01", "a03", "a7", "a8", "a12", "b2x3", "c"})
    EXPECT_TRUE(has_machine(list, machine)) << machine;
  for (const char* machine : {"", "a", "a1", "a04", "a13", "a7x", "b2", "b2x5", "b3x3", "cc", "log", "login,a01", "[1-2]"})
    EXPECT_FALSE(has_machine(list, machine)) << machine;
}

TEST(Programs, AJobThatIsElsewhereIsTold) {
  testing::Variable job("SLURM_JOB_ID", nullptr);
  testing::Variable nodes("SLURM_JOB_NODELIST", "elsewhere[1-4]");
  testing::Variable node("SLURMD_NODENAME", nullptr);
  EXPECT_TRUE(check_job_is_here().ok());
  job.set("999");
  EXPECT_NE(check_job_is_here().message().find("job 999, which is on elsewhere[1-4]"), std::string::npos);
  EXPECT_NE(check_job_is_here().hint().find("unset SLURM_JOB_ID"), std::string::npos);
  node.set("elsewhere3");  // the name that Slurm has for this machine
  EXPECT_TRUE(check_job_is_here().ok());
  node.set(nullptr);
  nodes.set(("elsewhere," + host_name()).c_str());
  EXPECT_TRUE(check_job_is_here().ok());
}

}  // namespace
}  // namespace rcb::launch
