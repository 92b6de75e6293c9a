// Both sides of TLS over a pair of sockets, driven in turn by one thread; and peers that don't speak it.
#include "common/tls/stream.hpp"

#include <array>
#include <random>
#include <vector>

#include <gtest/gtest.h>
#include <openssl/ssl.h>
#include <sys/socket.h>
#include <unistd.h>

#include "common/base/buffer.hpp"
#include "common/tls/openssl.hpp"

namespace rcb::tls {
namespace {

using Bytes = std::vector<std::byte>;

class Pair {
 public:
  Pair() {
    EXPECT_EQ(::socketpair(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0, sockets_.data()), 0);
    const int small = 1;  // the kernel takes its least, so that writes are cut short everywhere
    for (const int socket : sockets_) EXPECT_EQ(::setsockopt(socket, SOL_SOCKET, SO_SNDBUF, &small, sizeof small), 0);
  }
  ~Pair() {
    for (const int socket : sockets_)
      if (socket >= 0) ::close(socket);
  }
  int service() const { return sockets_[0]; }
  int client() const { return sockets_[1]; }
  void close_client() { ::close(std::exchange(sockets_[1], -1)); }

 private:
  std::array<int, 2> sockets_{};
};

struct Sides {
  explicit Sides(const Pair& pair, const Identity& identity)
      : service(std::move(Stream::accept(identity, pair.service()).value())),
        client(std::move(Stream::connect(pair.client()).value())) {}
  // True if both have shaken hands.
  bool shake_hands() {
    for (int turn = 0; turn < 100 && !(service->open() && client->open()); ++turn) {
      if (client->handshake().next == Next::failed) return false;
      if (service->handshake().next == Next::failed) return false;
    }
    return service->open() && client->open();
  }
  std::unique_ptr<Stream> service, client;
};

Bytes random_bytes(std::size_t count, unsigned seed) {
  std::mt19937_64 random(seed);
  Bytes bytes(count);
  for (std::byte& byte : bytes) byte = static_cast<std::byte>(random());
  return bytes;
}

// Sends all bytes from one side to the other, both in turn; what has arrived.
Bytes through(Stream& from, Stream& to, std::span<const std::byte> bytes) {
  Bytes arrived;
  Bytes piece(50000);
  const std::size_t all = bytes.size();
  for (int idle = 0; arrived.size() < all && idle < 100; ++idle) {
    if (!bytes.empty()) {
      const Progress put = from.write(bytes);
      EXPECT_TRUE(put.next == Next::done || put.next == Next::wait_writable) << from.why();
      bytes = bytes.subspan(put.bytes);
      if (put.bytes > 0) idle = 0;
    }
    const Progress got = to.read(piece);
    EXPECT_TRUE(got.next == Next::done || got.next == Next::wait_readable) << to.why();
    arrived.insert(arrived.end(), piece.begin(), piece.begin() + static_cast<std::ptrdiff_t>(got.bytes));
    if (got.bytes > 0) idle = 0;
  }
  return arrived;
}

TEST(Identity, IsAnotherOneEachTime) {
  const auto one = Identity::make().value();
  EXPECT_EQ(one->fingerprint().size(), 64U);
  EXPECT_EQ(one->fingerprint().find_first_not_of("0123456789abcdef"), std::string::npos);
  EXPECT_NE(Identity::make().value()->fingerprint(), one->fingerprint());
}

TEST(Stream, CarriesWhatIsWrittenBothWays) {
  const auto identity = Identity::make().value();
  const Pair pair;
  Sides sides(pair, *identity);
  ASSERT_TRUE(sides.shake_hands()) << sides.client->why() << sides.service->why();
  EXPECT_EQ(sides.client->certificate(), identity->fingerprint());
  EXPECT_EQ(sides.service->certificate(), identity->fingerprint());
  for (const std::size_t count : {1U, 100U, 16384U, 16385U, 3000000U}) {
    const Bytes bytes = random_bytes(count, static_cast<unsigned>(count));
    EXPECT_TRUE(through(*sides.client, *sides.service, bytes) == bytes) << count;
    EXPECT_TRUE(through(*sides.service, *sides.client, bytes) == bytes) << count;
  }
  std::array<std::byte, 8> rest{};
  EXPECT_EQ(sides.client->read(rest).next, Next::wait_readable);
  sides.service->end();
  EXPECT_EQ(sides.client->read(rest).next, Next::ended);
  EXPECT_EQ(sides.service->write(rest).next, Next::failed) << "the socket may be another's by now";
}

TEST(Stream, APeerThatHasGoneIsAnErrorAndNoSignal) {
  const auto identity = Identity::make().value();
  Pair pair;
  Sides sides(pair, *identity);
  ASSERT_TRUE(sides.shake_hands());
  pair.close_client();
  const Bytes bytes = random_bytes(100000, 1);
  Progress put;
  for (int turn = 0; turn < 100 && put.next != Next::done; ++turn) put = sides.service->write(bytes);
  EXPECT_EQ(put.next, Next::failed);
  EXPECT_FALSE(sides.service->why().empty());
}

TEST(Stream, WhatAnotherAltersIsNotTaken) {
  const auto identity = Identity::make().value();
  const Pair pair;
  Sides sides(pair, *identity);
  ASSERT_TRUE(sides.shake_hands());
  ASSERT_EQ(::send(pair.client(),
                   "\x17\x03\x03\x00\x20"
                   "ZAAABBBBCCCCDDDDEEEEFFFFGGGGHHHH",
                   37, 0),
            37);
  std::array<std::byte, 64> into{};
  EXPECT_EQ(sides.service->read(into).next, Next::failed);
  EXPECT_FALSE(sides.service->peer_has_gone());
  EXPECT_EQ(sides.client->read(into).next, Next::failed);
  EXPECT_NE(sides.client->why().find("alert"), std::string::npos) << "it was told: " << sides.client->why();
}

TEST(Stream, APeerWithoutTlsIsToldFromOne) {
  const auto identity = Identity::make().value();
  for (const std::string words : {"RCBD", "GET / HTTP/1.0\r\n\r\n", "\x17\x03\x03", "\x00"}) {
    const Pair pair;
    const auto service = std::move(Stream::accept(*identity, pair.service()).value());
    EXPECT_EQ(service->handshake().next, Next::wait_readable);
    EXPECT_FALSE(service->peer_is_plain());
    const std::size_t bytes = std::max<std::size_t>(words.size(), 1);
    ASSERT_EQ(::send(pair.client(), words.data(), bytes, 0), static_cast<ssize_t>(bytes));
    EXPECT_EQ(service->handshake().next, Next::failed);
    EXPECT_TRUE(service->peer_is_plain());
    EXPECT_FALSE(service->peer_has_begun());
    std::array<char, 64> heard{};
    EXPECT_LT(::recv(pair.client(), heard.data(), heard.size(), 0), 0) << "it was sent something";
    EXPECT_EQ(::recv(pair.service(), heard.data(), heard.size(), 0), static_cast<ssize_t>(bytes)) << "still to be read";
  }
  const Pair pair;  // a service that speaks first
  const auto client = std::move(Stream::connect(pair.client()).value());
  EXPECT_EQ(client->handshake().next, Next::wait_readable);
  ASSERT_EQ(::send(pair.service(), "RCBD", 4, 0), 4);
  EXPECT_EQ(client->handshake().next, Next::failed);
  EXPECT_TRUE(client->peer_is_plain());
}

TEST(Stream, APeerThatLeavesInTheMiddleIsNotWaitedFor) {
  const auto identity = Identity::make().value();
  for (const std::string words : {"", "\x16", "\x16\x03\x01"}) {
    Pair pair;
    const auto service = std::move(Stream::accept(*identity, pair.service()).value());
    EXPECT_EQ(service->handshake().next, Next::wait_readable);
    ASSERT_EQ(::send(pair.client(), words.data(), words.size(), 0), static_cast<ssize_t>(words.size()));
    pair.close_client();
    Progress progress{Next::wait_readable};
    for (int turn = 0; turn < 10 && progress.next == Next::wait_readable; ++turn) progress = service->handshake();
    EXPECT_EQ(progress.next, Next::failed) << words.size();
    EXPECT_FALSE(service->peer_is_plain());
    EXPECT_TRUE(service->peer_has_gone());
  }
}

// A client by OpenSSL alone, which offers these versions and resumes a session where it was given one.
int versions_agreed(const Identity& identity, int lowest, int highest) {
  const Pair pair;
  SSL_CTX* const context = SSL_CTX_new(TLS_client_method());
  SSL_CTX_set_min_proto_version(context, lowest);
  SSL_CTX_set_max_proto_version(context, highest);
  SSL* const client = SSL_new(context);
  SSL_set_fd(client, pair.client());
  SSL_set_connect_state(client);
  const auto service = std::move(Stream::accept(identity, pair.service()).value());
  for (int turn = 0; turn < 100 && SSL_is_init_finished(client) == 0; ++turn) {
    SSL_do_handshake(client);
    service->handshake();
  }
  char rest = 0;
  SSL_read(client, &rest, 1);  // takes tickets, were there any
  const bool resumable = SSL_is_init_finished(client) == 1 && SSL_SESSION_is_resumable(SSL_get_session(client)) == 1;
  EXPECT_FALSE(resumable) << "a connection that is resumed shows no certificate";
  const int version = SSL_is_init_finished(client) == 1 ? SSL_version(client) : 0;
  SSL_free(client);
  SSL_CTX_free(context);
  return version;
}

// A peer that renews its keys `times` times, after `data` bytes of data each; the last progress of the service's reads.
Progress after_renewals(int times, std::size_t data) {
  const auto identity = Identity::make().value();
  const Pair pair;
  const auto service = std::move(Stream::accept(*identity, pair.service()).value());
  const ContextPointer context(SSL_CTX_new(TLS_client_method()));
  const std::unique_ptr<SSL, Free<SSL_free>> client(SSL_new(context.get()));
  SSL_set_fd(client.get(), pair.client());
  for (int turn = 0; turn < 100 && (SSL_connect(client.get()) != 1 || !service->open()); ++turn) service->handshake();
  EXPECT_TRUE(service->open());
  const Bytes bytes = random_bytes(10000, 3);
  Bytes piece(50000);
  Progress progress{Next::wait_readable};
  const auto read = [&] {
    do progress = service->read(piece);
    while (progress.next == Next::done);
  };
  for (int k = 0; k < times && progress.next != Next::failed; ++k) {
    for (std::size_t sent = 0; sent < data && progress.next != Next::failed;) {
      std::size_t put = 0;
      if (SSL_write_ex(client.get(), bytes.data(), bytes.size(), &put) == 1) sent += put;
      read();
    }
    EXPECT_EQ(SSL_key_update(client.get(), SSL_KEY_UPDATE_NOT_REQUESTED), 1);
    while (progress.next != Next::failed && SSL_do_handshake(client.get()) != 1) read();
    if (k % 8 == 7) read();  // several at once
  }
  read();
  if (progress.next == Next::failed) {
    EXPECT_NE(service->why().find("renews its keys"), std::string::npos) << service->why();
  }
  return progress;
}

TEST(Stream, APeerThatOnlyRenewsItsKeysIsNotReadOn) {
  EXPECT_EQ(after_renewals(16, 0).next, Next::wait_readable);
  EXPECT_EQ(after_renewals(17, 0).next, Next::failed);
  EXPECT_EQ(after_renewals(1000, 0).next, Next::failed);
  EXPECT_EQ(after_renewals(40, std::size_t{1} << 20U).next, Next::wait_readable);
}

TEST(Stream, NothingOlderThanTls13IsSpoken) {
  const auto identity = Identity::make().value();
  EXPECT_EQ(versions_agreed(*identity, TLS1_3_VERSION, TLS1_3_VERSION), TLS1_3_VERSION);
  EXPECT_EQ(versions_agreed(*identity, TLS1_2_VERSION, TLS1_3_VERSION), TLS1_3_VERSION);
  EXPECT_EQ(versions_agreed(*identity, TLS1_2_VERSION, TLS1_2_VERSION), 0);
}

}  // namespace
}  // namespace rcb::tls
