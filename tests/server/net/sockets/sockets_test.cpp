// What serves the sockets: JSON parsed beside the I/O thread, and peers that vanish.
#include <cerrno>
#include <functional>
#include <memory>
#include <stdexcept>
#include <system_error>
#include <thread>
#include <vector>

#include <gtest/gtest.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>

#include "server/net/sockets/large_json.hpp"
#include "server/net/sockets/listen.hpp"
#include "tests/server/net/harness.hpp"

namespace rcb::net {
namespace {

using testing::run_until;

TEST(LargeJson, PlacesThatAreFreedTogetherAreTakenByAllWhoWait) {
  asio::io_context context;
  LargeJson& json = LargeJson::of(context);
  std::vector<LargeJson::Place> places;
  const auto take = [&]() -> awaitable<void> { places.push_back(co_await json.take_place()); };
  constexpr std::size_t kMax = LargeJson::kTextsMax;
  for (std::size_t k = 0; k < kMax + 3; ++k) asio::co_spawn(context, take, asio::detached);
  context.poll();
  ASSERT_EQ(places.size(), kMax);
  places.erase(places.begin(), places.begin() + 2);  // before anybody has run
  run_until(context, [&] { return places.size() == kMax; });
  places.erase(places.begin());
  run_until(context, [&] { return places.size() == kMax; });
}

// When a service ends while clients send large requests, coroutines that wait for a place may be destroyed before those
// that hold one, and thereby free it. The address sanitizer tells whether that touches what has gone.
TEST(LargeJson, WhoWaitsMayEndBeforeWhoHoldsAPlace) {
  constexpr std::size_t kMax = LargeJson::kTextsMax;
  std::size_t holding = 0;
  asio::io_context context;
  const auto hold = [&]() -> awaitable<void> {
    const LargeJson::Place place = co_await LargeJson::of(context).take_place();
    ++holding;
    Timer never(context, TimePoint::max());
    co_await never.async_wait(kAwait);
  };
  for (std::size_t k = 0; k < kMax + 3; ++k) asio::co_spawn(context, hold, asio::detached);
  context.poll();
  EXPECT_EQ(holding, kMax);
}

// A context's LargeJson to which the system gives no thread.
TEST(LargeJson, WithoutAThreadItIsParsedAllTheSame) {
  asio::io_context context;
  const auto none = [](const SideThread::Job&) -> std::thread {
    throw std::system_error(EAGAIN, std::generic_category());
  };
  LargeJson json(context, none);
  std::vector<Result<wire::Json>> parsed;
  const auto parse = [&](std::string text) -> awaitable<void> {
    parsed.push_back(co_await json.parse(std::move(text)));
  };
  asio::co_spawn(context, parse(R"({"a":1})"), asio::detached);
  asio::co_spawn(context, parse("{"), asio::detached);
  run_until(context, [&] { return parsed.size() == 2; });
  ASSERT_TRUE(parsed[0].ok());
  EXPECT_EQ((*parsed[0])["a"], 1);
  EXPECT_FALSE(parsed[1].ok());
}

// A solver that is started in its place waits for a minute.
TEST(Tcp, AClientThatVanishesIsMissedWithinHalfAMinute) {
  asio::io_context context;
  auto acceptor = listen_tcp(context, "127.0.0.1:0", Network::loopback);
  ASSERT_TRUE(acceptor.ok());
  std::vector<Socket> taken;
  asio::co_spawn(
      context,
      accept_all(context, *acceptor, [&](Socket socket, const Status&) { taken.push_back(std::move(socket)); }),
      asio::detached);
  asio::ip::tcp::socket client(context);
  client.connect(acceptor->local_endpoint());
  run_until(context, [&] { return !taken.empty(); });
  ASSERT_FALSE(taken.empty());
  const auto option = [&](int level, int name) {
    int value = 0;
    socklen_t size = sizeof value;
    EXPECT_EQ(::getsockopt(taken[0].native_handle(), level, name, &value, &size), 0);
    return value;
  };
  EXPECT_NE(option(SOL_SOCKET, SO_KEEPALIVE), 0);
  const int idle = option(IPPROTO_TCP, TCP_KEEPIDLE);
  const int between = option(IPPROTO_TCP, TCP_KEEPINTVL);
  EXPECT_LE(idle + between * option(IPPROTO_TCP, TCP_KEEPCNT), 30) << "where nothing is sent";
  EXPECT_GT(option(IPPROTO_TCP, TCP_USER_TIMEOUT), 0) << "where something is";
  EXPECT_LE(option(IPPROTO_TCP, TCP_USER_TIMEOUT), 30'000);
}

TEST(IoLoop, WhoWaitsForATaskIsToldThatItHasThrown) {
  IoLoop loop;
  loop.start();
  EXPECT_THROW(loop.run([] { throw std::runtime_error("a bug"); }), std::runtime_error);
  bool ran = false;
  loop.run([&ran] { ran = true; });
  EXPECT_TRUE(ran);
}

}  // namespace
}  // namespace rcb::net
