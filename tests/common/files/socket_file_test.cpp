// Which sockets are taken for left over.
#include "common/files/socket_file.hpp"

#include <cstring>
#include <filesystem>
#include <string>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include "common/files/descriptor.hpp"
#include "tests/support/directory.hpp"

namespace rcb {
namespace {

namespace fs = std::filesystem;

class SocketFile : public testing::DirectoryTest {
 protected:
  // A bound socket of that age.
  Descriptor bound(const std::string& name, int minutes) const {
    const std::string path = at(name);
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::memcpy(address.sun_path, path.c_str(), path.size());
    Descriptor socket(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
    EXPECT_EQ(::bind(socket.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
    const timespec then{::time(nullptr) - 60 * minutes, 0};
    const timespec times[]{then, then};
    EXPECT_EQ(::utimensat(AT_FDCWD, path.c_str(), times, 0), 0);
    return socket;
  }
  bool exists(const std::string& name) const { return fs::exists(at(name)); }
};

TEST_F(SocketFile, OnlyOldOnesWithoutAListenerAreRemoved) {
  const Descriptor young = bound("rcbd-young", 0);
  const Descriptor old = bound("rcbd-old", 2);
  const Descriptor live = bound("rcbd-live", 2);
  const Descriptor foreign = bound("other", 2);
  ASSERT_EQ(::listen(live.get(), 1), 0);
  remove_old_dead_sockets(directory_, "rcbd-");
  EXPECT_TRUE(exists("rcbd-young"));
  EXPECT_FALSE(exists("rcbd-old"));
  EXPECT_TRUE(exists("rcbd-live"));
  EXPECT_TRUE(exists("other"));
}

}  // namespace
}  // namespace rcb
