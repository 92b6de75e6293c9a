// The launcher against programs named rcbd that fail, hang or boast: what is told, and that nothing is left.
#include "client/launch/launch.hpp"

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "client/launch/job/programs.hpp"
#include "client/launch/log_tail.hpp"
#include "common/files/endpoint_lock.hpp"
#include "common/files/own_files.hpp"
#include "tests/support/directory.hpp"
#include "tests/support/wait.hpp"

namespace rcb::launch {
namespace {

namespace fs = std::filesystem;
using testing::eventually;

// A folder with a script named rcbd, which the launcher takes, and a TMPDIR to be left empty.
class Launch : public testing::DirectoryTest {
 protected:
  void SetUp() override {
    fs::create_directories(folder_ / "tmp");
    fs::create_directories(folder_ / "bin");
    setenv("RCBD_BIN_DIR", (folder_ / "bin").c_str(), 1);
    setenv("TMPDIR", (folder_ / "tmp").c_str(), 1);
  }
  void TearDown() override {
    unsetenv("RCBD_BIN_DIR");
    unsetenv("TMPDIR");
  }

  void program(const std::string& body) const {
    const fs::path path = folder_ / "bin" / "rcbd";
    std::ofstream(path) << "#!/bin/sh\n" << body << "\n";
    fs::permissions(path, fs::perms::owner_all);
  }
  SuperviseOptions options() const {
    SuperviseOptions o;
    o.endpoint = "unix:" + (folder_ / "s").string();
    o.data_dir = (folder_ / "data").string();
    o.ranks = 2;
    o.ready_seconds = 2;
    return o;
  }
  // The script's processes are gone: each wrote its number there.
  bool all_gone() const {
    for (const auto& entry : fs::directory_iterator(folder_))
      if (const std::string name = entry.path().filename(); name.starts_with("pid."))
        if (kill(std::stoi(name.substr(4)), 0) == 0) return false;
    return true;
  }
  std::string hanging() const { return "touch " + (folder_ / "pid.").string() + "$$; exec sleep 1000"; }
  long started() const {
    return std::count_if(fs::directory_iterator(folder_), fs::directory_iterator(),
                         [](const auto& entry) { return entry.path().filename().string().starts_with("pid."); });
  }

  const fs::path folder_ = directory_;
};

TEST_F(Launch, TellsTheReasonOfAFailedStart) {
  program("echo 'error: the moon is in the wrong phase' >&2; exit 3");
  SuperviseOptions o = options();
  o.ready_seconds = 1000;  // the test's own limit tells if this is waited for
  const Status status = start_detached(o, {});
  EXPECT_EQ(status.code(), Code::aborted);
  EXPECT_NE(status.message().find("the moon is in the wrong phase"), std::string::npos) << status.message();
  EXPECT_NE(status.hint().find("rcbd.log"), std::string::npos) << status.hint();
}

TEST_F(Launch, GivesUpOnAServiceThatNeverAnswersAndLeavesNothing) {
  program(hanging());
  const Status status = start_detached(options(), {});
  EXPECT_EQ(status.code(), Code::deadline_exceeded) << status.message();
  EXPECT_TRUE(all_gone());
}

TEST_F(Launch, TakesNoDataDirectoryTwice) {
  program(hanging());
  const SuperviseOptions o = options();
  ASSERT_TRUE(make_own_directory(o.data_dir).ok());
  EndpointNote other;
  other.process = ProcessId::self();
  other.endpoint = "unix:/elsewhere";
  other.data_dir = o.data_dir;
  const auto lock = take_data_directory(other);
  ASSERT_TRUE(lock.ok());
  const Status status = start_detached(o, {});
  EXPECT_EQ(status.code(), Code::busy);
  for (const std::string& said : {o.data_dir, other.endpoint})
    EXPECT_NE(status.message().find(said), std::string::npos) << status.message();
  EXPECT_EQ(started(), 0);
}

TEST_F(Launch, TakesNoEndpointTwiceWhateverTheDataDirectory) {
  program(hanging());
  EndpointNote other;
  other.process = ProcessId::self();
  other.endpoint = options().endpoint;
  other.data_dir = "/another";
  auto lock = take_endpoint(other);
  ASSERT_TRUE(lock.ok()) << lock.status().message();
  const Status status = start_detached(options(), {});
  EXPECT_EQ(status.code(), Code::busy);
  EXPECT_NE(status.message().find("/another"), std::string::npos) << status.message();
  EXPECT_EQ(started(), 0);
  EXPECT_TRUE(lock->in_place());
}

TEST_F(Launch, RefusesALogThatLeadsElsewhere) {
  program(hanging());
  const SuperviseOptions o = options();
  ASSERT_TRUE(make_own_directory(o.data_dir).ok());
  std::ofstream(folder_ / "precious") << "precious";
  fs::create_symlink(folder_ / "precious", log_path(o.data_dir));
  const Status status = start_detached(o, {});
  EXPECT_EQ(status.code(), Code::not_authorised) << status.message();
  EXPECT_NE(status.message().find(log_path(o.data_dir)), std::string::npos) << status.message();
  EXPECT_EQ(fs::file_size(folder_ / "precious"), 8U);
  EXPECT_EQ(started(), 0);
}

TEST_F(Launch, AFolderWithoutRcbdIsNotPassedOver) {
  setenv("RCBD_BIN_DIR", "/nowhere", 1);
  const auto found = find_rcbd();
  EXPECT_EQ(found.status().code(), Code::not_found);
  EXPECT_NE(found.status().message().find("RCBD_BIN_DIR is /nowhere"), std::string::npos);
}

TEST_F(Launch, AFailedEmbeddedServiceLeavesNoFolder) {
  program("exit 1");
  const auto service = Embedded::start(1, {});
  EXPECT_EQ(service.status().code(), Code::aborted);
  EXPECT_TRUE(eventually([&] { return fs::is_empty(folder_ / "tmp"); }));
}

TEST_F(Launch, AnEmbeddedServiceDiesWithItsProgramHoweverThatEnds) {
  for (const int number : {SIGKILL, SIGINT, SIGTERM}) {
    program(hanging());
    const pid_t child = fork();
    if (child == 0) {
      signal(number, SIG_DFL);  // a shell's background job ignores SIGINT
      (void)Embedded::start(2, {});
      _exit(0);
    }
    ASSERT_TRUE(eventually([&] { return started() == 2; }));
    kill(child, number);
    int status = 0;
    ASSERT_EQ(waitpid(child, &status, 0), child);
    EXPECT_TRUE(WIFSIGNALED(status) && WTERMSIG(status) == number) << status;
    // Killed outright, the program can't wait for its service's end; otherwise it does.
    EXPECT_TRUE(number == SIGKILL ? eventually([&] { return all_gone(); }) : all_gone()) << "signal " << number;
    EXPECT_TRUE(eventually([&] { return fs::is_empty(folder_ / "tmp"); })) << "signal " << number;
    for (const auto& entry : fs::directory_iterator(folder_))
      if (entry.path().filename().string().starts_with("pid.")) fs::remove(entry.path());
  }
}

TEST_F(Launch, MpirunIsCalledAsOneNodeNeedsIt) {
  program("exit 0");
  EXPECT_EQ(find_rcbd().value(), (folder_ / "bin" / "rcbd").string());
  const auto line = mpirun_arguments(
      {.endpoint = "127.0.0.1:7470", .data_dir = "/data", .ranks = 3, .service_arguments = {"--log-level", "debug"}});
  ASSERT_TRUE(line.ok());
  const auto follows = [&](const std::string& first, const std::string& second) {
    const auto at = std::find(line->begin(), line->end(), first);
    return at != line->end() && at + 1 != line->end() && *(at + 1) == second;
  };
  EXPECT_TRUE(follows("--bind-to", "none"));
  EXPECT_TRUE(follows("btl", "vader,self"));
  EXPECT_TRUE(follows("shmem_sysv_priority", "100"));
  EXPECT_TRUE(follows("-n", "3"));
  EXPECT_TRUE(follows("--listen", "127.0.0.1:7470"));
  EXPECT_TRUE(follows("--data-dir", "/data"));
  EXPECT_TRUE(follows("--log-level", "debug"));
  EXPECT_NE(std::find(line->begin(), line->end(), "--oversubscribe"), line->end());
  EXPECT_EQ(std::find(line->begin(), line->end(), "--allow-run-as-root") != line->end(), geteuid() == 0);
}

TEST_F(Launch, TheLogsTailIsWhatTheProgramSaid) {
  const std::string path = folder_ / "log";
  const std::string rule = std::string(70, '-') + "\n";
  const std::string mpirun = rule + "mpirun noticed something\n" + rule;
  std::ofstream(path) << "error: port taken\nerror: port taken\n" << mpirun;
  EXPECT_EQ(log_tail(path), "error: port taken");
  EXPECT_EQ(telling_lines(mpirun), "mpirun noticed something");
  EXPECT_EQ(telling_lines(rule + "no program on b\n" + rule + "2 total processes failed to start\n"),
            "no program on b");
  // The first frame has the reason, and what follows it outside of frames adds nothing.
  const std::string sequels =
      "[vm:1] *** An error occurred in MPI_Init\n*** on a NULL communicator\n[vm:1] 2 more processes have sent help "
      "message a / b\n"
      "[vm:1] Set MCA parameter \"x\" to 0\n[vm:1] [[1,0],0] ORTE_ERROR_LOG: Error in file f\n";
  EXPECT_EQ(telling_lines(rule + "A call failed\n\n  Error: No space\n" + rule + sequels + rule + "orte_init failed\n" +
                          rule),
            "A call failed\n  Error: No space");
  EXPECT_EQ(telling_lines("[b:2] PMIX ERROR: OUT-OF-RESOURCE\n" + rule + "1 process returned\n" + rule),
            "[b:2] PMIX ERROR: OUT-OF-RESOURCE");
  EXPECT_EQ(telling_lines("ssh: no host a\r\n\r\nssh: no host a\n"), "ssh: no host a");
  EXPECT_EQ(telling_lines("[b:2] *** An error occurred in MPI_Init_thread\n"),
            "[b:2] *** An error occurred in MPI_Init_thread");  // mpirun has ended before it wrote why
  EXPECT_EQ(log_tail(path + ".none"), "");
}

class HostsOfJob : public ::testing::Test {
 protected:
  void TearDown() override {
    for (const char* name : {"SLURM_JOB_ID", "SLURM_TASKS_PER_NODE", "SLURM_NTASKS", "PBS_NODEFILE"}) unsetenv(name);
  }
  // The ranks for which there is room; negative: on this machine.
  static int room(const char* tasks) {
    setenv("SLURM_JOB_ID", "7", 1);
    setenv("SLURM_TASKS_PER_NODE", tasks, 1);
    const Hosts hosts = hosts_of_job();
    return hosts.several() ? hosts.job_tasks : -hosts.job_tasks;
  }
};

TEST_F(HostsOfJob, AreThoseOfSlurm) {
  EXPECT_FALSE(hosts_of_job().several());
  EXPECT_EQ(room("4(x2),3"), 11);
  EXPECT_EQ(room("2,1"), 3);
  EXPECT_EQ(room("1(x3)"), 3);
  for (const char* one_machine_or_odd : {"4", "", "4(x1)", "4(x", "4(x2", "x2", "0(x2)", "4(x2)3", "4,,3"})
    EXPECT_EQ(room(one_machine_or_odd), 0) << one_machine_or_odd;
  setenv("SLURM_NTASKS", "4", 1);  // as sbatch --ntasks sets it
  EXPECT_EQ(room("4"), -4);
  EXPECT_EQ(room("4(x2)"), 8);
}

TEST_F(HostsOfJob, AreThoseOfPbs) {
  const std::string file = ::testing::TempDir() + "/rcb-nodes";
  setenv("PBS_NODEFILE", file.c_str(), 1);
  std::ofstream(file) << "a\na\n";
  EXPECT_FALSE(hosts_of_job().several()) << "one machine";
  EXPECT_EQ(*hosts_of_job().slots(), 2);
  std::ofstream(file) << "a\n";
  EXPECT_EQ(hosts_of_job().job_tasks, 0) << "which PBS writes of a job that doesn't say";
  std::ofstream(file) << "a\na\nb\n";
  EXPECT_EQ(hosts_of_job().file, file);
  EXPECT_EQ(*hosts_of_job().slots(), 3);
  fs::remove(file);
  EXPECT_FALSE(hosts_of_job().several());
}

}  // namespace
}  // namespace rcb::launch
