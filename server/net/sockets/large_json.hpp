// LargeJson: parses large JSON texts on a thread beside the I/O thread, one after another, so that heartbeats and other
// clients don't wait. Each io_context has one. Where the system gives no thread, the I/O thread parses.
//
// Invariant: at most kTextsMax texts of more than kWithoutPlaceBytes are in memory; further ones wait unread, others
// don't: a client that sends slowly holds up only those. A text must arrive whole within a frame's time.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "common/base/status.hpp"
#include "common/files/side_thread.hpp"
#include "common/wire/limits.hpp"
#include "common/wire/message.hpp"
#include "server/net/sockets/asio.hpp"

namespace rcb::net {

class LargeJson : public asio::execution_context::service {
 public:
  using key_type = LargeJson;
  static asio::execution_context::id id;
  static constexpr int kTextsMax = 4;
  static constexpr std::uint64_t kWithoutPlaceBytes = std::uint64_t{256} << 10U;

  // context: an io_context; Asio's use_service() knows it by its base class.
  explicit LargeJson(asio::execution_context& context, SideThread::Start start = {})
      : service(context),
        place_freed_(static_cast<asio::io_context&>(context), TimePoint::max()),
        thread_(std::in_place, wire::kJsonBytesMax * kTextsMax + kWithoutPlaceBytes * wire::kSessionsMax,
                std::move(start)) {}
  static LargeJson& of(asio::io_context& context) { return asio::use_service<LargeJson>(context); }

  // A place among the texts in memory, held by its copies.
  using Place = std::shared_ptr<LargeJson>;
  awaitable<Place> take_place();
  // Parses on the other thread.
  awaitable<Result<wire::Json>> parse(std::string text);

 private:
  void shutdown() override { thread_.reset(); }

  int places_taken_ = 0;
  // Whoever wants a place waits here; cancelled when one is freed. Asio knows who waits, also at the end of the
  // context, when it destroys those who wait and those who hold places in any order.
  Timer place_freed_;
  std::optional<SideThread> thread_;
};

}  // namespace rcb::net
