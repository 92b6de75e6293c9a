// A rank's own listener, spoken to with bare system calls.
#include "server/net/data/data_port.hpp"

#include <chrono>
#include <condition_variable>
#include <cstring>
#include <mutex>
#include <thread>

#include <gtest/gtest.h>

#include "tests/server/net/harness.hpp"
#include "tests/support/wait.hpp"

namespace rcb::net::testing {
namespace {

constexpr const char* kSession = "00000000000000aa";

class DataPortTest : public ::testing::Test {
 protected:
  DataPortTest() {
    DataOptions options;
    options.rank = 2;
    options.unknown_seconds = 0.2;
    options.credentials.token = "secret";
    options.spare = spare_;
    port_ = std::make_unique<DataPort>(loop_, options);
    EXPECT_TRUE(port_->listen_unix(path()).ok());
    auto tcp = port_->listen_tcp("127.0.0.1:0");
    EXPECT_TRUE(tcp.ok());
    tcp_ = tcp.ok() ? *tcp : "";
    port_->start([this](const SliceReport& report) {
      const std::lock_guard lock(mutex_);
      if (report.whole || !report.status.ok())
        reports_.emplace_back(report.number, report.status);
      else
        arrived_.emplace_back(report.number, report.bytes);
      changed_.notify_all();
    });
    loop_.start();
  }
  ~DataPortTest() override { loop_.stop(); }

  std::string path() const { return directory_ / "s.2"; }
  Client client() {
    Client made = Client::on_unix(path());
    EXPECT_EQ(made.hello("test", kSession).json["rank"], 2);
    return made;
  }
  void open(std::uint64_t number, std::int64_t step, std::uint64_t n) {
    PushTicket ticket;
    ticket.number = number;
    ticket.terms = {api::Push{.id = {"s", kSession, step, 0}, .n = n}, 3, 2};
    loop_.run([&] { port_->open(ticket); });
  }
  void drop(std::int64_t step) {
    loop_.run([&] { port_->drop({"s", kSession, step, 0}); });
  }
  std::vector<Slice> take(std::uint64_t number) {
    std::vector<Slice> slices;
    loop_.run([&] {
      if (auto slice = port_->take(number)) slices.push_back(std::move(*slice));
    });
    return slices;
  }
  // Values first, first + 1, ... for x and 1000 more for y.
  static void send(Client& client, std::int64_t step, std::uint64_t first, std::uint64_t count, int rank = 2) {
    std::string bulk;
    for (int axis = 0; axis < 2; ++axis)
      for (std::uint64_t i = 0; i < count; ++i) {
        const double value = static_cast<double>(first + i) + 1000 * axis;
        bulk.append(reinterpret_cast<const char*>(&value), sizeof value);
      }
    client.send(wire::FrameType::request,
                {{"command", "push.slice"},
                 {"scene", "s"},
                 {"step", step},
                 {"attempt", 0},
                 {"rank", rank},
                 {"first", first},
                 {"count", count},
                 {"arrays",
                  {{{"name", "x"}, {"dtype", "<f8"}, {"shape", {count}}},
                   {{"name", "y"}, {"dtype", "<f8"}, {"shape", {count}}}}}},
                bulk, first % 2 == 0);
  }
  Status report(std::uint64_t number) {
    std::unique_lock lock(mutex_);
    const auto found = [&] {
      return std::find_if(reports_.begin(), reports_.end(), [&](const auto& r) { return r.first == number; });
    };
    if (!changed_.wait_for(lock, std::chrono::seconds(rcb::testing::kWaitSeconds),
                           [&] { return found() != reports_.end(); }))
      return {Code::internal, "no report came"};
    return found()->second;
  }

  IoLoop loop_;
  Directory directory_;
  std::shared_ptr<api::SpareMemory> spare_ = std::make_shared<api::SpareMemory>();
  std::unique_ptr<DataPort> port_;
  std::unique_ptr<DataPort> replaced_;  // as every port, it is destroyed after its loop has stopped
  std::string tcp_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<std::pair<std::uint64_t, Status>> reports_;
  std::vector<std::pair<std::uint64_t, std::uint64_t>> arrived_;
};

// Nothing is read behind a slice that waits for its push, so nobody would see the end of the connection there.
TEST_F(DataPortTest, AClientThatHasGoneKeepsNoPlaceWhileItsSlicesWait) {
  DataOptions options;
  options.rank = 2;
  options.unknown_seconds = 600;
  options.connections_max = 1;
  DataPort patient(loop_, options);
  const std::string socket = directory_ / "patient";
  ASSERT_TRUE(patient.listen_unix(socket).ok());
  loop_.run([&] { patient.start([](const SliceReport&) {}); });
  for (int round = 0; round < 3; ++round) {
    Client gone = Client::on_unix(socket);
    Received hello = gone.hello("gone", kSession);
    const auto let_in = [&hello] { return hello.json.value("rank", -1) == 2; };
    for (int tries = 0; tries < 500 && !let_in(); ++tries) {  // it is told `busy`, or late on a slow machine
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
      gone = Client::on_unix(socket);
      hello = gone.hello("gone", kSession);
    }
    ASSERT_TRUE(let_in()) << "round " << round << ": " << hello.json;
    for (std::int64_t step = 0; step < 5; ++step) send(gone, step, 0, 3);
  }
  loop_.stop();  // a port is destroyed after its loop has stopped
}

// The limit on the time between two bytes is for who reads: a slice may wait for its push for longer.
TEST_F(DataPortTest, ASliceMayWaitForItsPushLongerThanAFrameForItsBytes) {
  DataOptions options;
  options.rank = 2;
  options.frame_seconds = 0.1;
  options.unknown_seconds = 600;
  replaced_ = std::exchange(port_, std::make_unique<DataPort>(loop_, options));
  const std::string socket = directory_ / "patient";
  ASSERT_TRUE(port_->listen_unix(socket).ok());
  loop_.run([&] {
    port_->start([this](const SliceReport& report) {
      const std::lock_guard lock(mutex_);
      if (report.whole || !report.status.ok()) reports_.emplace_back(report.number, report.status);
      changed_.notify_all();
    });
  });
  Client sender = Client::on_unix(socket);
  ASSERT_EQ(sender.hello("test", kSession).json["rank"], 2);
  send(sender, 4, 0, 3000);  // more than is read with the header
  std::this_thread::sleep_for(std::chrono::milliseconds(500));
  open(7, 4, 3000);
  const Status whole = report(7);
  EXPECT_TRUE(whole.ok()) << whole.message();
  EXPECT_EQ(take(7).size(), 1U);
}

TEST_F(DataPortTest, OtherFramesOfAPushThatNeverCameAreNotWaitedFor) {
  Client sender = client();
  constexpr int kFrames = 500;  // each by itself would wait 0.2 s, which is longer than a report is waited for
  for (int frame = 0; frame < kFrames; ++frame) send(sender, 1, 0, 3);
  open(9, 2, 3);
  send(sender, 2, 0, 3);
  EXPECT_TRUE(report(9).ok());
}

TEST_F(DataPortTest, ASliceInPiecesIsOneArrayAnAxis) {
  Client sender = client();
  for (std::int64_t step = 0; step < 2; ++step) {
    const auto number = static_cast<std::uint64_t>(step) + 7;
    open(number, step, 50);
    send(sender, step, 0, 20);
    send(sender, step, 20, 0);
    send(sender, step, 20, 30);
    const Status whole = report(number);
    EXPECT_TRUE(whole.ok()) << whole.message();
    auto slices = take(number);
    ASSERT_EQ(slices.size(), 1U);
    ASSERT_EQ(slices[0].arrays.size(), 2U);
    std::vector<Buffer<std::byte>> spare;
    for (std::size_t a = 0; a < 2; ++a) {
      const auto values = slices[0].arrays[a].bytes.release_as<double>();
      ASSERT_EQ(values.size(), 50U);
      for (std::size_t i = 0; i < 50; ++i) EXPECT_EQ(values[i], static_cast<double>(i) + 1000 * static_cast<double>(a));
      Buffer<double> copy = values;
      spare.push_back(copy.release_as<std::byte>());
    }
    spare_->keep("s", std::move(spare));
    EXPECT_TRUE(take(number).empty());
  }
}

// Longer than a read, in frames that end anywhere; the first attempt is given up in the midst of one.
TEST_F(DataPortTest, ALongSliceInSeveralFramesIsWhole) {
  constexpr std::uint64_t kCount = 150'001;
  Client sender = client();
  open(1, 1, kCount);
  send(sender, 1, 0, 100'000);
  drop(1);
  open(2, 2, kCount);
  send(sender, 2, 0, 70'001);
  send(sender, 2, 70'001, 80'000);
  EXPECT_TRUE(report(2).ok());
  const auto slices = take(2);
  ASSERT_EQ(slices.size(), 1U);
  for (std::size_t axis = 0; axis < 2; ++axis) {
    const auto* const values = reinterpret_cast<const double*>(slices[0].arrays[axis].bytes.data());
    ASSERT_EQ(slices[0].arrays[axis].bytes.size(), 8 * kCount);
    for (std::uint64_t i = 0; i < kCount; ++i)
      ASSERT_EQ(values[i], static_cast<double>(i) + 1000 * static_cast<double>(axis));
  }
}

TEST_F(DataPortTest, WhatComesForNoPushIsDroppedAndTheNextIsTaken) {
  Client sender = client();
  send(sender, 1, 0, 10);  // never opened
  drop(2);
  send(sender, 2, 0, 10);  // refused before it came
  open(1, 3, 10);
  drop(3);
  send(sender, 3, 0, 10);  // given up
  send(sender, 4, 0, 10);  // comes before it is opened
  open(2, 4, 10);
  EXPECT_TRUE(report(2).ok());
  EXPECT_TRUE(take(1).empty());
  EXPECT_EQ(take(2).size(), 1U);
}

TEST_F(DataPortTest, FaultsNameThemselves) {
  Client sender = client();
  open(2, 2, 10);
  send(sender, 2, 1, 5);
  EXPECT_EQ(report(2).code(), Code::invalid_argument);
  open(3, 3, 10);
  send(sender, 3, 0, 11);
  EXPECT_EQ(report(3).code(), Code::invalid_argument);
  open(4, 4, 10);
  send(sender, 4, 0, 5, 1);
  EXPECT_EQ(report(4).code(), Code::invalid_argument);
  open(5, 5, 10);
  Client other = client();
  send(sender, 5, 0, 4);
  send(other, 5, 4, 4);
  send(other, 5, 8, 2);
  // Whichever of the two came first, the other is one too many.
  EXPECT_EQ(report(5).code(), Code::invalid_argument);
  open(6, 6, 10);
  send(other, 6, 0, 4);
  other.close();
  const Status lost = report(6);
  EXPECT_EQ(lost.code(), Code::aborted);
  EXPECT_NE(lost.message().find("rank 2"), std::string::npos) << lost.message();
  open(7, 7, 0);
  EXPECT_TRUE(report(7).ok());
  open(8, 8, 2);
  send(sender, 8, 0, 2);
  EXPECT_TRUE(report(8).ok());
}

TEST_F(DataPortTest, OverTcpTheTokenIsAsked) {
  Client wrong = Client::on_tcp(tcp_);
  EXPECT_EQ(wrong.hello("test", kSession, "guess", "rank 2").code(), "not_authorised");
  Client right = Client::on_tcp(tcp_);
  EXPECT_EQ(right.hello("test", kSession, "secret", "rank 2").json["rank"], 2);
  right.send(wire::FrameType::request, {{"command", "status"}});
  EXPECT_EQ(right.receive().code(), "protocol_error");
  EXPECT_TRUE(right.receive().ended);
}

}  // namespace
}  // namespace rcb::net::testing
