// What a killed job leaves is found and removed by the next one, whatever its endpoint; what a live one has stays.
#include "client/launch/job/job_folder.hpp"

#include <algorithm>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <string>

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include "common/files/socket_file.hpp"
#include "tests/support/directory.hpp"

namespace rcb::launch {
namespace {

namespace fs = std::filesystem;

class Folder : public testing::DirectoryTest {
 protected:
  EndpointNote owner() const {
    EndpointNote note;
    note.process = ProcessId::self();
    note.endpoint = "unix:" + directory_ + "/s";
    note.data_dir = directory_ + "/data";
    return note;
  }
  static void listen_at(const std::string& path) {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::memcpy(address.sun_path, path.c_str(), path.size());
    const int socket = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (::bind(socket, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0 || ::listen(socket, 1) != 0)
      ::_exit(1);
  }
  // A process with a job's folder (its path in `place`), sockets and data, which waits to be killed.
  pid_t job() const {
    int ready[2];
    EXPECT_EQ(::pipe(ready), 0);
    const pid_t child = ::fork();
    if (child == 0) {
      auto folder = JobFolder::make(directory_, 1);
      if (!folder.ok()) ::_exit(1);
      folder->sign(owner());
      std::ofstream(folder->path() + "/session") << "x";
      fs::create_directories(owner().data_dir);
      listen_at(directory_ + "/s");
      listen_at(directory_ + "/s.0");
      const std::string path = folder->path() + "\n";
      if (::write(ready[1], path.data(), path.size()) < 0) ::_exit(1);
      for (;;) ::pause();
    }
    ::close(ready[1]);
    place_.clear();
    for (char c = 0; ::read(ready[0], &c, 1) == 1 && c != '\n';) place_ += c;
    ::close(ready[0]);
    EXPECT_TRUE(fs::exists(place_ + "/session")) << place_;
    return child;
  }
  static void end(pid_t child) {
    ::kill(child, SIGKILL);
    EXPECT_EQ(::waitpid(child, nullptr, 0), child);
  }
  static bool names(const std::vector<std::string>& removed, const std::string& path) {
    return std::find(removed.begin(), removed.end(), path) != removed.end();
  }

  mutable std::string place_;
};

TEST_F(Folder, OfALiveJobStaysOfAKilledOneGoesWithItsSockets) {
  const pid_t child = job();
  EXPECT_FALSE(names(JobFolder::sweep(directory_), place_));
  EXPECT_TRUE(fs::exists(place_));
  end(child);
  EXPECT_TRUE(fs::exists(place_));
  const auto removed = JobFolder::sweep(directory_);
  for (const std::string& path : {place_, directory_ + "/s", directory_ + "/s.0"}) {
    EXPECT_TRUE(names(removed, path)) << path;
    EXPECT_FALSE(fs::exists(path)) << path;
  }
  EXPECT_TRUE(fs::exists(owner().data_dir)) << "log and token of a service that may be started again";
  EXPECT_FALSE(fs::exists(directory_ + "/s.lock"));
}

TEST_F(Folder, WhoeverServesTheEndpointByNowKeepsItsSockets) {
  end(job());
  const auto lock = take_endpoint(owner());
  ASSERT_TRUE(lock.ok());
  (void)JobFolder::sweep(directory_);
  EXPECT_FALSE(fs::exists(place_));
  EXPECT_TRUE(fs::exists(directory_ + "/s"));
}

TEST_F(Folder, GoesWithItsOwner) {
  std::string path;
  {
    const auto folder = JobFolder::make(directory_, 1);
    ASSERT_TRUE(folder.ok());
    path = folder->path();
    EXPECT_TRUE(fs::exists(path));
  }
  EXPECT_FALSE(fs::exists(path));
}

}  // namespace
}  // namespace rcb::launch
