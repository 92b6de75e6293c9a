// A service of two ranks with listeners of their own, in which a test may have the scene "s", of 2 dimensions and 4
// parts, told and pushed to by any way. The second rank may be on another host.
#pragma once

#include <memory>
#include <mutex>
#include <vector>

#include <sys/mman.h>

#include "tests/client/lib/fake_service.hpp"
#include "tests/client/lib/told_cuts.hpp"

namespace rcb::client {

class TwoRanks {
 public:
  static constexpr const char* kToken = "secret";

  explicit TwoRanks(bool second_apart = false) {
    for (int rank = 0; rank < 2; ++rank)
      ranks_.push_back(std::make_unique<FakeService>([this, rank](Peer& peer, int) { serve_rank(peer, rank); },
                                                     rank == 1 && second_apart));
    control_ = std::make_unique<FakeService>([this](Peer& peer, int) { serve(peer); });
  }
  ~TwoRanks() { stop(); }

  const std::string& endpoint() const { return control_->endpoint(); }
  // What follows may be read after this, when the client has gone.
  void stop() {
    control_->stop();
    for (const auto& rank : ranks_) rank->stop();
  }

  protocol::Json scene = protocol::Json::object();  // more of what scene.open tells
  std::vector<protocol::Json> begun;
  std::vector<Received> slices;  // over the ranks' own connections
  // The array of this name in the memory that a push shares with rank 0, as it is when the push begins.
  std::vector<std::map<std::string, std::vector<std::int64_t>>> shared;

 private:
  void serve_rank(Peer& peer, int rank) {
    const bool tcp = !ranks_[static_cast<std::size_t>(rank)]->endpoint().starts_with("unix:");
    const std::string nonce = tcp ? auth::random_nonce() : "";
    peer.send(protocol::FrameType::welcome, 0, Peer::welcome(nonce));
    const auto hello = peer.receive();
    if (!hello) return;
    protocol::Json json{{"rank", rank}};
    if (tcp) json["proof"] = Peer::proof(auth::Role::service, kToken, nonce, *hello, "rank " + std::to_string(rank));
    peer.reply(*hello, json);
    while (auto frame = peer.receive()) {
      const std::lock_guard lock(mutex_);
      const auto command = frame->json.value("command", "");
      if (command == "push.slice") {
        slices.push_back(std::move(*frame));
        continue;
      }
      if (command == "memory.share" && rank == 0) {
        const auto bytes = frame->json["bytes"].get<std::size_t>();
        const void* const at = ::mmap(nullptr, bytes, PROT_READ, MAP_SHARED, peer.descriptor(), 0);
        ASSERT_NE(at, MAP_FAILED);
        memory_[frame->json["memory"].get<std::int64_t>()] = static_cast<const char*>(at);  // to the end of the test
      }
      peer.reply(*frame, protocol::Json::object());
    }
  }

  void serve(Peer& peer) {
    peer.send(protocol::FrameType::welcome, 0, Peer::welcome());
    const auto hello = peer.receive();
    if (!hello) return;
    peer.reply(
        *hello,
        {{"session", hello->json["session"]}, {"ranks", 2}, {"data", {ranks_[0]->endpoint(), ranks_[1]->endpoint()}}});
    while (const auto frame = peer.receive()) {
      const auto command = frame->json.value("command", "");
      if (command == "push") {
        push(peer, *frame);
        continue;
      }
      protocol::Json json{{"scene", "s"}, {"dims", 2}, {"parts", 4}, {"n", 0}, {"step", nullptr}};
      json.update(scene);
      if (frame->json.contains("seat")) json["seat"] = {{"generation", 1}};
      peer.reply(*frame, json);
    }
  }

  void push(Peer& peer, const Received& begin) {
    begun.push_back(begin.json);
    const auto n = begin.json["n"].get<std::size_t>();
    shared.emplace_back();
    for (const protocol::Json& array : begin.json.value("memory", protocol::Json::array())) {
      const std::lock_guard lock(mutex_);
      const char* at = memory_.at(array["number"].get<std::int64_t>()) + array["offset"].get<std::size_t>();
      auto& values = shared.back()[array["name"].get<std::string>()];
      for (std::size_t i = 0; i < n; ++i, at += array["stride"].get<std::size_t>())
        std::memcpy(&values.emplace_back(), at, sizeof(std::int64_t));
    }
    protocol::Json answer{
        {"report", {{"scene", "s"}, {"step", begin.json["step"]}, {"n", n}, {"reason", ""}, {"epoch", 1}}}};
    std::vector<protocol::Array> arrays;
    ToldCuts(2, 4, 1).add_unless_known(begin.json["cuts_known"], answer, arrays);
    peer.reply(begin, answer, arrays);
  }

  std::mutex mutex_;
  std::map<std::int64_t, const char*> memory_;
  std::vector<std::unique_ptr<FakeService>> ranks_;
  std::unique_ptr<FakeService> control_;
};

}  // namespace rcb::client
