// A scripted service in a thread: it takes connections on a Unix socket or on TCP and does with each what the test
// says. No wait of it is longer than kWaitSeconds, so a broken client fails a test instead of hanging it.
#pragma once

#include <array>
#include <atomic>
#include <cstring>
#include <exception>
#include <functional>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "common/auth/proof.hpp"
#include "tests/support/directory.hpp"
#include "tests/support/protocol.hpp"
#include "tests/support/wait.hpp"

namespace rcb::client {

namespace protocol = testing::protocol;

using testing::Directory;
using Received = protocol::Frame;

// One connection, seen from the service.
class Peer {
 public:
  explicit Peer(int handle) : handle_(handle) {
    const timeval limit{rcb::testing::kWaitSeconds, 0};
    ::setsockopt(handle_, SOL_SOCKET, SO_RCVTIMEO, &limit, sizeof limit);
    ::setsockopt(handle_, SOL_SOCKET, SO_SNDTIMEO, &limit, sizeof limit);
  }
  ~Peer() {
    ::close(handle_);
    if (descriptor_ >= 0) ::close(descriptor_);
  }
  Peer(const Peer&) = delete;
  Peer& operator=(const Peer&) = delete;

  bool send_bytes(std::string_view bytes) {
    while (!bytes.empty()) {
      const ssize_t sent = ::send(handle_, bytes.data(), bytes.size(), MSG_NOSIGNAL);
      if (sent <= 0) return false;
      bytes.remove_prefix(static_cast<std::size_t>(sent));
    }
    return true;
  }
  bool send(protocol::FrameType type, std::uint64_t request, protocol::Json json,
            const std::vector<protocol::Array>& arrays = {}, bool summed = false) {
    return send_bytes(protocol::frame(type, request, std::move(json), arrays, summed));
  }
  bool reply(const Received& to, protocol::Json json, const std::vector<protocol::Array>& arrays = {},
             bool summed = false) {
    return send(protocol::FrameType::reply, to.request, std::move(json), arrays, summed);
  }
  bool fail(const Received& to, const Status& status) {
    return send(protocol::FrameType::failure, to.request, protocol::failure_json(status));
  }

  bool read(void* data, std::size_t size) {
    auto* to = static_cast<char*>(data);
    while (size > 0) {
      const ssize_t got = receive_some(to, size);
      if (got <= 0) return false;
      to += got;
      size -= static_cast<std::size_t>(got);
    }
    return true;
  }
  // That came last with a frame; -1: none.
  int descriptor() const { return descriptor_; }
  // The next frame, by the rules of PROTOCOL.md; none at the end of the connection.
  std::optional<Received> receive() {
    return protocol::receive([this](char* to, std::size_t size) { return read(to, size); });
  }

  // Header and JSON of the next frame alone, and how many bytes follow.
  std::pair<Received, std::uint64_t> receive_head() {
    std::array<char, 40> header{};
    Received head;
    std::uint32_t json_bytes = 0;
    std::uint64_t bulk_bytes = 0;
    if (!read(header.data(), header.size())) return {};
    std::memcpy(&json_bytes, header.data() + 12, sizeof json_bytes);
    std::memcpy(&head.request, header.data() + 16, sizeof head.request);
    std::memcpy(&bulk_bytes, header.data() + 24, sizeof bulk_bytes);
    std::string text(json_bytes, '\0');
    if (read(text.data(), text.size())) head.json = protocol::Json::parse(text);
    return {head, bulk_bytes};
  }

  // nonce: where a proof of the token is asked for.
  static protocol::Json welcome(const std::string& nonce = {}) {
    protocol::Json json{{"server", "rcbd"},
                        {"protocol", 2},
                        {"authentication", nonce.empty() ? "none" : "hmac-sha256"},
                        {"limits", protocol::Json::object()}};
    if (!nonce.empty()) json["nonce"] = nonce;
    return json;
  }
  // Welcome and hello as they should be, over TCP with a service's proof of the token; the hello, or none. instance: of
  // the service; another one after a restart.
  std::optional<Received> greet(int ranks, const std::string& instance = "0000000000000001",
                                const std::string& token = {}) {
    const std::string nonce = token.empty() ? "" : auth::random_nonce();
    if (!send(protocol::FrameType::welcome, 0, welcome(nonce))) return std::nullopt;
    auto hello = receive();
    if (!hello) return hello;
    protocol::Json json{{"session", hello->json["session"]}, {"ranks", ranks}, {"instance", instance}};
    if (!token.empty()) json["proof"] = proof(auth::Role::service, token, nonce, *hello);
    reply(*hello, std::move(json));
    return hello;
  }
  // What proves that `role` knows the token, after this nonce and hello.
  static std::string proof(auth::Role role, const std::string& token, const std::string& nonce, const Received& hello,
                           const std::string& listener = "endpoint") {
    return auth::proof(role, token, {listener, nonce, hello.json.value("nonce", ""), hello.json.value("session", "")});
  }

 private:
  ssize_t receive_some(char* to, std::size_t size) {
    iovec piece{to, size};
    alignas(cmsghdr) char control[CMSG_SPACE(sizeof(int))];
    msghdr message{};
    message.msg_iov = &piece;
    message.msg_iovlen = 1;
    message.msg_control = control;
    message.msg_controllen = sizeof control;
    const ssize_t got = ::recvmsg(handle_, &message, MSG_CMSG_CLOEXEC);
    const cmsghdr* const with = got > 0 ? CMSG_FIRSTHDR(&message) : nullptr;
    if (with != nullptr && with->cmsg_type == SCM_RIGHTS) {
      if (descriptor_ >= 0) ::close(descriptor_);
      std::memcpy(&descriptor_, CMSG_DATA(with), sizeof descriptor_);
    }
    return got;
  }

  int handle_;
  int descriptor_ = -1;
};

class FakeService {
 public:
  // number: of the connection, from 0. When it returns, the connection is closed.
  using Script = std::function<void(Peer& peer, int number)>;

  explicit FakeService(Script script, bool tcp = false) : script_(std::move(script)) {
    handle_ = ::socket(tcp ? AF_INET : AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (tcp) {
      sockaddr_in address{};
      address.sin_family = AF_INET;
      address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
      socklen_t size = sizeof address;
      EXPECT_EQ(::bind(handle_, reinterpret_cast<sockaddr*>(&address), size), 0);
      EXPECT_EQ(::getsockname(handle_, reinterpret_cast<sockaddr*>(&address), &size), 0);
      endpoint_ = "127.0.0.1:" + std::to_string(ntohs(address.sin_port));
    } else {
      const std::string path = directory_ / "socket";
      sockaddr_un address{};
      address.sun_family = AF_UNIX;
      std::memcpy(address.sun_path, path.c_str(), path.size() + 1);
      EXPECT_EQ(::bind(handle_, reinterpret_cast<sockaddr*>(&address), sizeof address), 0);
      endpoint_ = "unix:" + path;
    }
    EXPECT_EQ(::listen(handle_, 8), 0);
    thread_ = std::thread([this] { serve(); });
  }
  ~FakeService() { stop(); }
  FakeService(const FakeService&) = delete;
  FakeService& operator=(const FakeService&) = delete;

  // Takes no further connection and waits for the script to end; call it before looking at what the script wrote.
  void stop() {
    if (!thread_.joinable()) return;
    stopped_ = true;
    ::shutdown(handle_, SHUT_RDWR);
    thread_.join();
    ::close(handle_);
  }
  const std::string& endpoint() const { return endpoint_; }

 private:
  void serve() {
    for (int number = 0; !stopped_; ++number) {
      const int connection = ::accept4(handle_, nullptr, nullptr, SOCK_CLOEXEC);
      if (connection < 0) return;
      Peer peer(connection);
      try {
        if (!stopped_) script_(peer, number);
      } catch (const std::exception& wrong) {
        ADD_FAILURE() << "what the client sent: " << wrong.what();
      }
    }
  }

  Directory directory_;
  Script script_;
  std::string endpoint_;
  int handle_ = -1;
  std::atomic<bool> stopped_{false};
  std::thread thread_;
};

}  // namespace rcb::client
