// LargeJson: parses large JSON texts on a thread beside the I/O thread, one after another, so that heartbeats and other
// clients don't wait. Each io_context has one.
//
// Invariant: at most kTextsMax large texts are in memory; further ones wait unread. A text must arrive whole within a
// frame's time, so nobody waits long.
#pragma once

#include <cstddef>
#include <deque>
#include <memory>
#include <optional>
#include <string>

#include <boost/asio/thread_pool.hpp>

#include "common/base/status.hpp"
#include "common/wire/message.hpp"
#include "server/net/sockets/asio.hpp"

namespace rcb::net {

class LargeJson : public asio::execution_context::service {
 public:
  using key_type = LargeJson;
  static asio::execution_context::id id;
  static constexpr int kTextsMax = 4;

  explicit LargeJson(asio::execution_context& context) : service(context) {}

  // A place among the texts in memory, held by its copies.
  using Place = std::shared_ptr<LargeJson>;
  awaitable<Place> take_place();
  // Parses on the other thread.
  awaitable<Result<wire::Json>> parse(const std::string& text);

 private:
  void shutdown() override;

  int places_taken_ = 0;
  std::deque<Timer*> waiting_;
  std::optional<asio::thread_pool> pool_;  // one thread, created at first use
};

}  // namespace rcb::net
