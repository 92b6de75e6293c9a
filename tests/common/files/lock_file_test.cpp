// One holder at a time, whoever removes the file; the kernel frees what a killed process held.
#include "common/files/lock_file.hpp"

#include <filesystem>
#include <fstream>
#include <string>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/file.h>
#include <sys/wait.h>
#include <unistd.h>

#include "common/files/endpoint_lock.hpp"
#include "common/files/socket_file.hpp"
#include "tests/support/directory.hpp"

namespace rcb {
namespace {

namespace fs = std::filesystem;

class Lock : public testing::DirectoryTest {};

TEST_F(Lock, HasOneHolderWhoseNoteIsRead) {
  EXPECT_FALSE(LockFile::holder(at("l")));
  auto first = LockFile::take(at("l"), "first\n");
  ASSERT_TRUE(first.ok()) << first.status().message();
  EXPECT_EQ(LockFile::take(at("l"), "second").status().code(), Code::busy);
  EXPECT_EQ(LockFile::holder(at("l")), "first");
  ASSERT_TRUE(first->write("changed").ok());
  EXPECT_EQ(LockFile::holder(at("l")), "changed");
  { const LockFile gone = std::move(*first); }
  EXPECT_FALSE(fs::exists(at("l")));
  std::ofstream(at("l")) << std::string(LockFile::kNoteBytes, 'x');  // left by a process that was killed
  fs::permissions(at("l"), fs::perms::owner_read | fs::perms::owner_write);
  EXPECT_FALSE(LockFile::holder(at("l")));
  EXPECT_TRUE(LockFile::take(at("l"), "next").ok());
}

TEST_F(Lock, ARemovedFileIsNoLockAndItsHolderNoticesAndLeavesTheNextOne) {
  auto first = LockFile::take(at("l"), "first");
  ASSERT_TRUE(first.ok());
  EXPECT_TRUE(first->in_place());
  fs::remove(at("l"));
  EXPECT_FALSE(first->in_place());
  auto second = LockFile::take(at("l"), "second");
  ASSERT_TRUE(second.ok());
  { const LockFile gone = std::move(*first); }
  EXPECT_TRUE(second->in_place());
  EXPECT_EQ(LockFile::holder(at("l")), "second");
}

TEST_F(Lock, IsFreedWithItsProcess) {
  int ready[2];
  ASSERT_EQ(::pipe(ready), 0);
  const pid_t child = ::fork();
  if (child == 0) {
    const auto lock = LockFile::take(at("l"), "child");
    if (::write(ready[1], lock.ok() ? "y" : "n", 1) != 1) ::_exit(1);
    ::pause();
  }
  char said = 0;
  ASSERT_EQ(::read(ready[0], &said, 1), 1);
  EXPECT_EQ(said, 'y');
  EXPECT_EQ(LockFile::holder(at("l")), "child");
  ::kill(child, SIGKILL);
  ASSERT_EQ(::waitpid(child, nullptr, 0), child);
  EXPECT_TRUE(fs::exists(at("l")));
  EXPECT_TRUE(LockFile::take(at("l"), "next").ok());
  ::close(ready[0]);
  ::close(ready[1]);
}

TEST_F(Lock, IsNotTakenThroughALink) {
  std::ofstream(at("precious")) << "precious";
  fs::create_symlink(at("precious"), at("l"));
  EXPECT_EQ(LockFile::take(at("l"), "note").status().code(), Code::not_authorised);
  EXPECT_EQ(fs::file_size(at("precious")), 8U);
}

TEST_F(Lock, IsNoFileOfTheUsers) {
  std::ofstream(at("l")) << "precious";
  EXPECT_EQ(LockFile::take(at("l"), "note").status().code(), Code::io_error);
  EXPECT_EQ(fs::file_size(at("l")), 8U);
  std::ofstream(at("m")).close();  // a full disk has left it empty
  EXPECT_TRUE(LockFile::take(at("m"), "note").ok());
}

// The folder may be anybody's to open, as /tmp is.
TEST_F(Lock, AForeignLockOnTheFolderIsNoObstacle) {
  const int folder = ::open(directory_.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  ASSERT_EQ(::flock(folder, LOCK_EX | LOCK_NB), 0);
  EXPECT_TRUE(LockFile::take(at("l"), "note").ok());
  ::close(folder);
}

TEST_F(Lock, AnEndpointHasOneServerWhateverItsDataDirectory) {
  EndpointNote one;
  one.process = ProcessId::self();
  one.program = "rcbctl up";
  one.endpoint = "unix:" + at("s");
  one.data_dir = at("one");
  EndpointNote two = one;
  two.data_dir = at("two");
  auto lock = take_endpoint(one);
  ASSERT_TRUE(lock.ok()) << lock.status().message();
  const Status refused = take_endpoint(two).status();
  EXPECT_EQ(refused.code(), Code::busy);
  for (const std::string& said : {one.endpoint, one.data_dir, std::to_string(::getpid())})
    EXPECT_NE(refused.message().find(said), std::string::npos) << refused.message();
  EXPECT_EQ(endpoint_holder(one.endpoint)->process, ProcessId::self());
  // A rank of that supervisor's may go on under its lock, another's may not.
  const std::string path = endpoint_lock_path(one.endpoint);
  EXPECT_FALSE(held_by_supervisor(path));
  ::setenv(kSupervisorVariable, ProcessId::self().text().c_str(), 1);
  EXPECT_TRUE(held_by_supervisor(path));
  ::setenv(kSupervisorVariable, ProcessId::of(1).text().c_str(), 1);
  EXPECT_FALSE(held_by_supervisor(path));
  ::unsetenv(kSupervisorVariable);
}

TEST_F(Lock, ANoteIsReadAsItWasWritten) {
  EndpointNote note;
  note.process = ProcessId::self();
  note.program = "rcbctl up";
  note.endpoint = "unix:/a b/s";
  note.data_dir = "/a b/data";
  note.deaths = 7;
  note.failures = 3;
  note.start_at_unix = 1e9;
  note.last_reason = "first line\nsecond line " + std::string(3000, 'x');
  const EndpointNote read = EndpointNote::parse(note.text());
  EXPECT_EQ(read.process, note.process);
  EXPECT_EQ(read.endpoint, note.endpoint);
  EXPECT_EQ(read.data_dir, note.data_dir);
  EXPECT_EQ(read.deaths, 7);
  EXPECT_EQ(read.failures, 3);
  EXPECT_EQ(read.start_at_unix, 1e9);
  EXPECT_EQ(read.last_reason.substr(0, 22), "first line second line");
  EXPECT_LT(note.text().size(), LockFile::kNoteBytes);
  EXPECT_NE(describe(note).find("died 7 times"), std::string::npos) << describe(note);
  for (const char* nonsense : {"", "process", "process x\n\n\n", "process 1.\ndeaths -\n"})
    EXPECT_EQ(EndpointNote::parse(nonsense).process.pid, -1) << nonsense;
}

TEST_F(Lock, AProcessIsKnownByItsStartToo) {
  EXPECT_TRUE(ProcessId::self().exists());
  ProcessId earlier = ProcessId::self();
  --earlier.start;
  EXPECT_FALSE(earlier.exists());
  EXPECT_EQ(ProcessId::parse(earlier.text()), earlier);
}

}  // namespace
}  // namespace rcb
