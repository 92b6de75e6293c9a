// Doorbells: the same orders everywhere, nobody lost in silence, nobody lost at a clean end.
#include "server/net/peers/doorbell.hpp"

#include <algorithm>
#include <condition_variable>
#include <cstddef>
#include <filesystem>
#include <mutex>
#include <optional>
#include <thread>
#include <vector>

#include <gtest/gtest.h>
#include <malloc.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "tests/server/net/harness.hpp"
#include "tests/support/wait.hpp"

namespace rcb::net {
namespace {

using testing::Directory;

// What a rank saw, readable from the test.
class Log {
 public:
  void add(const std::string& line) {
    const std::lock_guard lock(mutex_);
    lines_.push_back(line);
    changed_.notify_all();
  }
  bool wait_for(std::size_t count) {
    std::unique_lock lock(mutex_);
    return changed_.wait_for(lock, std::chrono::seconds(rcb::testing::kWaitSeconds),
                             [&] { return lines_.size() >= count; });
  }
  std::vector<std::string> lines() const {
    const std::lock_guard lock(mutex_);
    return lines_;
  }

 private:
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<std::string> lines_;
};

struct Rank {
  ~Rank() { loop.stop(); }  // its handlers write to what follows
  void connect(int number, const DoorbellAddress& address) {
    auto opened = Doorbell::connect(
        loop, number, address, true, 6,
        [this](std::uint64_t order, const wire::Json& request) { orders.add(std::to_string(order) + request.dump()); },
        [this](const std::string& what) { lost.add(what); });
    ASSERT_TRUE(opened.ok());
    bell = std::move(*opened);
    bell->on_peer_message([this](int, const wire::Json& word) { words.add(word.dump()); });
    loop.start();
  }
  IoLoop loop;
  Log orders;
  Log lost;
  Log words;
  std::unique_ptr<Doorbell> bell;
};

class Bells : public ::testing::Test {
 protected:
  void open(int ranks) {
    auto opened = DoorbellHub::open(loop_, {.ranks = ranks, .silence_seconds = 6, .folder = directory_.path()},
                                    [this](const std::string& what) { lost_.add(what); });
    ASSERT_TRUE(opened.ok());
    hub_ = std::move(*opened);
  }
  void start(int ranks, PeerMessageHandler message = {}) {
    open(ranks);
    if (HasFatalFailure()) return;
    hub_->on_peer_message(std::move(message));
    loop_.start();
    for (int r = 1; r < ranks; ++r) {
      ranks_.push_back(std::make_unique<Rank>());
      ranks_.back()->connect(r, hub_->address());
      if (HasFatalFailure()) return;
    }
    ASSERT_TRUE(hub_->wait_connected(20).ok());
    for (int r = 1; r < ranks; ++r) {  // until a rank has checked the hub's proof as well, it says nothing
      loop_.run([&] { hub_->tell(r, {{"rank", r}}); });
      ASSERT_TRUE(ranks_[static_cast<std::size_t>(r) - 1]->words.wait_for(1));
    }
  }

  ~Bells() override { loop_.stop(); }
  Directory directory_;
  IoLoop loop_;
  Log lost_;
  std::unique_ptr<DoorbellHub> hub_;
  std::vector<std::unique_ptr<Rank>> ranks_;
};

TEST_F(Bells, RingAlikeEverywhereAndLeaveNoFile) {
  auto alone = DoorbellHub::open(loop_, {.ranks = 2, .folder = directory_.path()}, [](const std::string&) {});
  ASSERT_TRUE(alone.ok());
  // Nobody else of this machine can connect.
  const std::filesystem::path folder = std::filesystem::path((*alone)->address().path).parent_path();
  EXPECT_EQ(folder.parent_path(), directory_.path());
  EXPECT_EQ(std::filesystem::status(folder).permissions(), std::filesystem::perms::owner_all);
  alone->reset();
  EXPECT_TRUE(std::filesystem::is_empty(directory_.path()));
  // Where there can't be a socket it is elsewhere.
  const std::string deep = directory_.path() + "/" + std::string(100, 'd');
  std::filesystem::create_directory(deep);
  for (const std::string& unfit : {deep, directory_.path() + "/none"}) {
    auto elsewhere = DoorbellHub::open(loop_, {.ranks = 2, .folder = unfit}, [](const std::string&) {});
    ASSERT_TRUE(elsewhere.ok()) << elsewhere.status().message();
    EXPECT_TRUE((*elsewhere)->address().path.starts_with("/tmp/doorbell-"));
  }
  EXPECT_TRUE(std::filesystem::is_empty(deep));
  std::filesystem::remove(deep);
  start(4);
  EXPECT_TRUE(std::filesystem::is_empty(directory_.path()));
  std::vector<std::string> expected;
  for (std::uint64_t i = 1; i <= 200; ++i) {
    const std::string text = R"({"value":)" + std::to_string(i) + "}";
    loop_.run([&] { hub_->ring(i, text); });
    expected.push_back(std::to_string(i) + text);
  }
  for (const auto& rank : ranks_) {
    ASSERT_TRUE(rank->orders.wait_for(200));
    EXPECT_EQ(rank->orders.lines(), expected);
  }
}

// What is queued for the ranks is one text. Under sanitizers, whose allocators don't count so, this tells nothing.
TEST_F(Bells, AnOrderIsInMemoryOnce) {
  constexpr std::size_t kRanks = 5;
  constexpr std::size_t kBytes = std::size_t{8} << 20U;
  start(kRanks);
  if (HasFatalFailure()) return;
  const auto taken = [] {
    const struct mallinfo2 info = ::mallinfo2();
    return info.uordblks + info.hblkhd;
  };
  const std::string text = R"({"fill":")" + std::string(kBytes, 'x') + R"("})";
  std::size_t grown = 0;
  loop_.run([&] {
    const std::size_t before = taken();
    hub_->ring(1, text);
    grown = taken() - before;
  });
  EXPECT_LT(grown, 2 * kBytes);
  for (const auto& rank : ranks_) EXPECT_TRUE(rank->orders.wait_for(1));
}

TEST_F(Bells, ACleanEndLosesNobody) {
  start(3);
  std::vector<std::thread> ends;
  for (const auto& rank : ranks_) ends.emplace_back([&rank] { rank->bell->finish(20); });
  hub_->finish(20);
  for (std::thread& end : ends) end.join();
  loop_.stop();
  EXPECT_TRUE(lost_.lines().empty());
  for (const auto& rank : ranks_) EXPECT_TRUE(rank->lost.lines().empty());
}

TEST_F(Bells, ADeadRankIsMissed) {
  start(3);
  ranks_[1]->bell.reset();
  ranks_[1].reset();  // its sockets close, as a killed process's do
  ASSERT_TRUE(lost_.wait_for(1));
  EXPECT_NE(lost_.lines()[0].find("rank 2"), std::string::npos);
}

TEST_F(Bells, ADeadCoordinatorIsMissed) {
  auto hub_loop = std::make_unique<IoLoop>();
  auto opened = DoorbellHub::open(*hub_loop, {.ranks = 2, .silence_seconds = 6, .folder = directory_.path()},
                                  [](const std::string&) {});
  ASSERT_TRUE(opened.ok());
  hub_loop->start();
  Rank rank;
  auto bell = Doorbell::connect(
      rank.loop, 1, (*opened)->address(), true, 6, [](std::uint64_t, const wire::Json&) {},
      [&rank](const std::string& what) { rank.lost.add(what); });
  ASSERT_TRUE(bell.ok());
  rank.loop.start();
  ASSERT_TRUE((*opened)->wait_connected(20).ok());
  opened->reset();
  hub_loop.reset();
  ASSERT_TRUE(rank.lost.wait_for(1));
}

TEST_F(Bells, SilenceIsCountedInTicks) {
  start(2);
  ranks_[0]->loop.stop();  // as a stopped process: connected, and dumb
  EXPECT_TRUE(hub_->silent().empty());
  for (int i = 0; i < 3; ++i) loop_.run([&] { hub_->tick(); });
  EXPECT_TRUE(lost_.lines().empty());
  ASSERT_EQ(hub_->silent().size(), 1U);
  EXPECT_EQ(hub_->silent()[0].rank, 1);
  EXPECT_EQ(hub_->silent()[0].seconds, 3 * kTickSeconds);
  loop_.run([&] { hub_->tick(); });
  ASSERT_EQ(lost_.lines().size(), 1U);
  EXPECT_NE(lost_.lines()[0].find("silent"), std::string::npos);
  loop_.run([&] { hub_->tick(); });
  EXPECT_EQ(lost_.lines().size(), 1U);  // once
}

TEST_F(Bells, SignsOfLifeAreSentUnasked) {
  Log words;
  start(2, [&words](int from, const wire::Json& word) { words.add(std::to_string(from) + word.dump()); });
  for (std::size_t i = 1; i <= 30; ++i) {
    ranks_[0]->loop.run([&] { ranks_[0]->bell->tick({{"executed", i}}); });
    ASSERT_TRUE(words.wait_for(i));
    loop_.run([&] { hub_->tick(); });
  }
  EXPECT_EQ(words.lines().back(), R"(1{"executed":30})");
  EXPECT_TRUE(lost_.lines().empty());
}

// A slow link between a rank and the hub: what the hub sends passes as the test lets it.
class SlowLink {
 public:
  explicit SlowLink(const std::string& to) : to_(to) {
    listener_ = ::socket(AF_UNIX, SOCK_STREAM, 0);
    const sockaddr_un address = named(path());
    EXPECT_EQ(::bind(listener_, reinterpret_cast<const sockaddr*>(&address), size(path())), 0);
    EXPECT_EQ(::listen(listener_, 1), 0);
    accept_ = std::thread([this] { carry(); });
  }
  ~SlowLink() {
    let_pass(std::uint64_t{1} << 40U);
    for (const int socket : {listener_, near_, far_}) ::shutdown(socket, SHUT_RDWR);
    accept_.join();
    for (const int socket : {listener_, near_, far_}) ::close(socket);
  }
  std::string path() const { return to_ + "-slow"; }
  void let_pass(std::uint64_t bytes) {
    const std::lock_guard lock(mutex_);
    may_pass_ += bytes;
    changed_.notify_all();
  }

 private:
  static sockaddr_un named(const std::string& name) {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::copy(name.begin(), name.end(), address.sun_path);
    return address;
  }
  static socklen_t size(const std::string& name) {
    return static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + name.size());
  }
  void carry() {
    near_ = ::accept(listener_, nullptr, nullptr);
    far_ = ::socket(AF_UNIX, SOCK_STREAM, 0);
    const sockaddr_un address = named(to_);
    EXPECT_EQ(::connect(far_, reinterpret_cast<const sockaddr*>(&address), size(to_)), 0);
    std::thread back([this] {
      char bytes[4096];
      for (ssize_t got = 0; (got = ::read(near_, bytes, sizeof bytes)) > 0;)
        if (::send(far_, bytes, static_cast<std::size_t>(got), MSG_NOSIGNAL) != got) break;
    });
    char byte = 0;
    while (true) {
      {
        std::unique_lock lock(mutex_);
        changed_.wait(lock, [this] { return may_pass_ > 0; });
        --may_pass_;
      }
      if (::read(far_, &byte, 1) != 1 || ::send(near_, &byte, 1, MSG_NOSIGNAL) != 1) break;
    }
    back.join();
  }

  std::string to_;
  int listener_ = -1;
  int near_ = -1;
  int far_ = -1;
  std::thread accept_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::uint64_t may_pass_ = 4096;  // the handshake
};

TEST_F(Bells, AnOrderThatTakesLongOverASlowLinkIsNoSilence) {
  open(2);
  if (HasFatalFailure()) return;
  loop_.start();
  DoorbellAddress address = hub_->address();
  SlowLink link(address.path);
  address.path = link.path();
  Rank rank;
  rank.connect(1, address);
  if (HasFatalFailure()) return;
  ASSERT_TRUE(hub_->wait_connected(20).ok());
  loop_.run([&] { hub_->tell(1, {{"rank", 1}}); });
  ASSERT_TRUE(rank.words.wait_for(1));
  loop_.run([&] { hub_->ring(7, R"({"value":")" + std::string(20'000, 'x') + "\"}"); });
  // What was still to pass of the 4096 bytes, then some before each tick.
  for (int tick = 0; tick < 12; ++tick) {
    link.let_pass(500);
    std::this_thread::sleep_for(std::chrono::milliseconds(30));
    rank.loop.run([&] { rank.bell->tick(wire::Json::object()); });
  }
  EXPECT_TRUE(rank.lost.lines().empty());
  EXPECT_TRUE(rank.orders.lines().empty()) << "it is still on its way";
  link.let_pass(20'000);
  EXPECT_TRUE(rank.orders.wait_for(1));
  // Where nothing comes it is silence.
  for (int tick = 0; tick < 4; ++tick) rank.loop.run([&] { rank.bell->tick(wire::Json::object()); });
  EXPECT_EQ(rank.lost.lines().size(), 1U);
}

TEST_F(Bells, AStrangerIsNotARank) {
  auto opened = DoorbellHub::open(loop_, {.ranks = 2, .silence_seconds = 6, .folder = directory_.path()},
                                  [this](const std::string& what) { lost_.add(what); });
  ASSERT_TRUE(opened.ok());
  loop_.start();
  Rank stranger;
  DoorbellAddress address = (*opened)->address();
  address.secret[0] = address.secret[0] == 'a' ? 'b' : 'a';
  auto bell = Doorbell::connect(
      stranger.loop, 1, address, true, 6, [](std::uint64_t, const wire::Json&) {},
      [&](const std::string& what) { stranger.lost.add(what); });
  ASSERT_TRUE(bell.ok());
  stranger.loop.start();
  EXPECT_TRUE(stranger.lost.wait_for(1));
  EXPECT_EQ((*opened)->wait_connected(0.1).code(), Code::deadline_exceeded);
  hub_ = std::move(*opened);
}

}  // namespace
}  // namespace rcb::net
