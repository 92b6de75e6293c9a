// What lies in the file system: socket, lock, token, marker.
#include <filesystem>
#include <fstream>
#include <future>
#include <memory>

#include <gtest/gtest.h>
#include <sys/stat.h>

#include "common/files/paths.hpp"
#include "common/files/socket_file.hpp"
#include "server/net/files/data_directory.hpp"
#include "server/net/files/socket_name.hpp"
#include "server/net/sockets/file_thread.hpp"
#include "server/net/sockets/listen.hpp"
#include "tests/server/net/harness.hpp"

namespace rcb::net::testing {
namespace {

namespace fs = std::filesystem;

using rcb::testing::mode_of;

EndpointNote rcbd_at(const std::string& endpoint) {
  EndpointNote note;
  note.process = ProcessId::self();
  note.program = "rcbd";
  note.endpoint = endpoint;
  return note;
}

struct Listener {
  IoLoop loop;
  FakeEngine engine;
  Control control{loop, TestService::defaults(), engine};
};

TEST(Socket, IsPrivateAndGoesWithItsService) {
  const Directory directory;
  {
    Listener one;
    ASSERT_TRUE(one.control.listen_unix(directory / "s").ok());
    EXPECT_EQ(mode_of(directory / "s"), 0600U);
  }
  EXPECT_FALSE(fs::exists(directory / "s"));
}

TEST(Socket, ALiveOneIsRefusedAStaleOneReplaced) {
  const Directory directory;
  const std::string path = directory / "s";
  {
    Listener one;
    ASSERT_TRUE(one.control.listen_unix(path).ok());
    Listener two;
    const Status refused = two.control.listen_unix(path);
    EXPECT_EQ(refused.code(), Code::busy);
    EXPECT_NE(refused.message().find(path), std::string::npos);
    fs::create_hard_link(path, directory / "stale");  // outlives its listener
  }
  Listener three;
  EXPECT_TRUE(three.control.listen_unix(directory / "stale").ok());
}

TEST(Socket, AnothersThatHasTakenThePlaceStays) {
  const Directory directory;
  const std::string path = directory / "s";
  auto one = std::make_unique<Listener>();
  ASSERT_TRUE(one->control.listen_unix(path).ok());
  fs::remove(path);  // as somebody does who believes it stale
  Listener two;
  ASSERT_TRUE(two.control.listen_unix(path).ok());
  one.reset();
  EXPECT_EQ(socket_state(path), SocketState::live);
}

TEST(Socket, NamesAreRemovedTogetherWhereAProcessEndsAtOnce) {
  const Directory directory;
  Listener one;
  ASSERT_TRUE(one.control.listen_unix(directory / "s").ok());
  Listener two;
  ASSERT_TRUE(two.control.listen_unix(directory / "t").ok());
  fs::remove(directory / "t");
  std::ofstream(directory / "t") << "precious";
  SocketName::remove_all();
  EXPECT_FALSE(fs::exists(directory / "s"));
  EXPECT_TRUE(fs::exists(directory / "t"));
}

TEST(Socket, WhatNobodyListensOnIsRemovedTheRestStays) {
  const Directory directory;
  const std::string path = directory / "s";
  {
    Listener dead;
    ASSERT_TRUE(dead.control.listen_unix(path).ok());
    for (const char* name : {"s.0", "s.17", "s.1x", "other"}) fs::create_hard_link(path, directory / name);
  }
  Listener live;
  ASSERT_TRUE(live.control.listen_unix(directory / "s.2").ok());
  std::ofstream(directory / "s.3") << "precious";
  fs::rename(directory / "other", path);
  EXPECT_EQ(socket_state(path), SocketState::dead);
  EXPECT_EQ(remove_dead_sockets(path).size(), 3U);
  for (const char* name : {"s.1x", "s.2", "s.3"}) EXPECT_TRUE(fs::exists(directory / name)) << name;
  for (const char* name : {"s", "s.0", "s.17"}) EXPECT_FALSE(fs::exists(directory / name)) << name;
}

TEST(Socket, WhatIsNoSocketStays) {
  const Directory directory;
  std::ofstream(directory / "s") << "precious";
  Listener one;
  EXPECT_EQ(one.control.listen_unix(directory / "s").code(), Code::io_error);
  EXPECT_EQ(fs::file_size(directory / "s"), 8U);
  EXPECT_EQ(one.control.listen_unix(directory / "no/s").code(), Code::io_error);
}

TEST(Socket, ALongPathIsRefusedWithItsLimit) {
  Listener one;
  const Status refused = one.control.listen_unix("/tmp/" + std::string(kSocketPathMax, 'x'));
  EXPECT_EQ(refused.code(), Code::invalid_argument);
  EXPECT_NE(refused.message().find("107"), std::string::npos);
}

// A listener at `path` that has begun to accept.
class LastingSocket : public ::testing::Test {
 protected:
  void SetUp() override {
    ASSERT_TRUE(listener.listen(context, path).ok());
    listener.start([this](UnixAcceptor&) { ++accepting; });
  }
  // Looks, and waits until the look has ended.
  void look() {
    bool ended = false;
    listener.look();
    ASSERT_TRUE(FileThread::of(context).run([] {}, [&ended] { ended = true; }).ok());
    run_until(context, [&ended] { return ended; });
  }

  const Directory directory;
  const std::string path = directory / "s";
  asio::io_context context;
  LastingListener listener;
  int accepting = 0;
};

TEST_F(LastingSocket, WhatSomebodyRemovesIsMadeAgainUntilItIsClosed) {
  EXPECT_EQ(accepting, 1);
  look();
  EXPECT_EQ(accepting, 1) << "it was there";
  for (int again = 0; again < 3; ++again) {
    std::filesystem::remove(path);
    look();
    EXPECT_EQ(accepting, 2 + again);
    EXPECT_EQ(socket_state(path), SocketState::live);
  }
  // What isn't ours stays, and the socket comes back when it has gone.
  std::filesystem::remove(path);
  std::ofstream(path) << "somebody's";
  look();
  EXPECT_EQ(accepting, 4);
  EXPECT_TRUE(std::filesystem::is_regular_file(path));
  std::filesystem::remove(path);
  look();
  EXPECT_EQ(accepting, 5);
  listener.close();
  EXPECT_FALSE(std::filesystem::exists(path));
  look();
  EXPECT_FALSE(std::filesystem::exists(path)) << "a service that ends";
  EXPECT_EQ(accepting, 5);
}

TEST_F(LastingSocket, ALookAtADiskThatStandsStillHoldsUpNobody) {
  std::promise<void> moves;
  ASSERT_TRUE(FileThread::of(context).run([&moves] { moves.get_future().wait(); }, [] {}).ok());
  std::filesystem::remove(path);
  for (int tick = 0; tick < 3; ++tick) listener.look();
  context.poll();
  EXPECT_EQ(accepting, 1);
  moves.set_value();
  look();
  EXPECT_EQ(accepting, 2);
  EXPECT_EQ(socket_state(path), SocketState::live);
  // One that is closed while the disk is asked isn't made again.
  std::filesystem::remove(path);
  listener.look();
  listener.close();
  look();
  EXPECT_EQ(accepting, 2);
  EXPECT_FALSE(std::filesystem::exists(path));
}

TEST(Socket, TcpAddressesAreChecked) {
  Listener one;
  for (const char* wrong : {"", "7470", "host", "127.0.0.1:", "127.0.0.1:70000", "127.0.0.1:7x", ":7470"})
    EXPECT_EQ(one.control.listen_tcp(wrong).status().code(), Code::invalid_argument) << wrong;
  const auto bound = one.control.listen_tcp("127.0.0.1:0");
  ASSERT_TRUE(bound.ok());
  Listener two;
  EXPECT_EQ(two.control.listen_tcp(*bound).status().code(), Code::busy);
}

// Addresses of documents (RFC 5737, 3849), which no machine has.
TEST(Socket, OtherMachinesReachItOnlyWhereTheirNetworkIsTrustedOrTlsProtectsThem) {
  Listener one;  // without TLS
  for (const char* where : {"192.0.2.1:0", "0.0.0.0:0", "[::]:0", "[2001:db8::1]:0", "[::ffff:127.0.0.1]:0"}) {
    const Status refused = one.control.listen_tcp(where).status();
    EXPECT_EQ(refused.code(), Code::invalid_argument) << where;
    for (const char* remedy : {"--trusted-network", "127.0.0.1", "OpenSSL"})
      EXPECT_NE(refused.hint().find(remedy), std::string::npos) << refused.hint();
  }
  EXPECT_TRUE(one.control.listen_tcp("127.3.2.1:0").ok());
  ControlOptions trusting = TestService::defaults();
  trusting.credentials.token.insert(0, auth::kTrustedNetworkPrefix);
  ControlOptions encrypting = TestService::defaults();
  encrypting.credentials.identity = tls::Identity::make().value();
  for (const ControlOptions& options : {trusting, encrypting}) {
    Control control(one.loop, options, one.engine);
    EXPECT_EQ(control.listen_tcp("192.0.2.1:0").status().code(), Code::io_error);  // tried
  }
}

TEST(DataDirectory, HasOneServiceAtATime) {
  const Directory directory;
  auto first = DataDirectory::open(directory.path(), true, rcbd_at("unix:/somewhere"));
  ASSERT_TRUE(first.ok());
  const auto second = DataDirectory::open(directory.path(), true, rcbd_at("unix:/elsewhere"));
  EXPECT_EQ(second.status().code(), Code::busy);
  EXPECT_NE(second.status().message().find("unix:/somewhere"), std::string::npos) << second.status().message();
  { const DataDirectory gone = std::move(*first); }
  EXPECT_TRUE(DataDirectory::open(directory.path(), true, rcbd_at("unix:/s")).ok());
}

TEST(DataDirectory, MarkerStandsOnlyAfterACleanEnd) {
  const Directory directory;
  const std::string marker = directory / std::string(kCleanShutdownFile);
  {
    const auto data = DataDirectory::open(directory.path(), true, rcbd_at("unix:/s"));
    ASSERT_TRUE(data.ok());
    EXPECT_TRUE(leave_end_marker(data->path()).ok());
    EXPECT_TRUE(fs::exists(marker));
  }
  const auto data = DataDirectory::open(directory.path(), true, rcbd_at("unix:/s"));
  EXPECT_FALSE(fs::exists(marker));
}

TEST(DataDirectory, TokenIsPrivateAndNewAtEachStart) {
  const Directory directory;
  const auto data = DataDirectory::open(directory.path(), true, rcbd_at("unix:/s"));
  ASSERT_TRUE(data.ok());
  const auto token = data->new_token();
  ASSERT_TRUE(token.ok());
  EXPECT_EQ(token->size(), 64U);
  const std::string file = directory / std::string(kTokenFile);
  EXPECT_EQ(mode_of(file), 0600U);
  EXPECT_EQ(*data->kept_token(), *token);  // after a crash its clients go on
  const auto trusting = data->new_token(auth::kTrustedNetworkPrefix);
  EXPECT_TRUE(trusting->starts_with(auth::kTrustedNetworkPrefix)) << *trusting;
  EXPECT_EQ(*data->kept_token(auth::kTrustedNetworkPrefix), *trusting);
  EXPECT_FALSE(auth::trusts_network(*data->kept_token())) << "a token of one kind isn't kept for the other";
  EXPECT_TRUE(auth::trusts_network(*data->kept_token(auth::kTrustedNetworkPrefix)));
  const auto fresh = data->new_token();
  ASSERT_TRUE(fresh.ok());
  EXPECT_NE(*fresh, *token);
  EXPECT_EQ(*data->kept_token(), *fresh);
  ASSERT_EQ(::chmod(file.c_str(), 0644), 0);  // others may have read it
  const auto unread = data->kept_token();
  ASSERT_TRUE(unread.ok());
  EXPECT_NE(*unread, *fresh);
  EXPECT_EQ(mode_of(file), 0600U);
}

TEST(DataDirectory, IsMadePrivateUnlessTheUserNamedIt) {
  const Directory directory;
  ASSERT_TRUE(DataDirectory::open(directory / "a/b", false, rcbd_at("unix:/s")).ok());
  EXPECT_EQ(mode_of(directory / "a/b"), 0700U);
  fs::create_symlink(directory.path(), directory / "link");
  EXPECT_FALSE(DataDirectory::open(directory / "link", false, rcbd_at("unix:/s")).ok());
  EXPECT_TRUE(DataDirectory::open(directory / "link", true, rcbd_at("unix:/s")).ok());
}

TEST(DataDirectory, IsTheSupervisorsWhereARankHasOne) {
  const Directory directory;
  EndpointNote supervisor = rcbd_at("unix:/s");
  supervisor.data_dir = directory.path();
  const auto lock = take_data_directory(supervisor);
  ASSERT_TRUE(lock.ok());
  EXPECT_EQ(DataDirectory::open(directory.path(), true, rcbd_at("unix:/s")).status().code(), Code::busy);
  ::setenv(kSupervisorVariable, supervisor.process.text().c_str(), 1);
  EXPECT_TRUE(DataDirectory::open(directory.path(), true, rcbd_at("unix:/s")).ok());
  ::unsetenv(kSupervisorVariable);
}

}  // namespace
}  // namespace rcb::net::testing
