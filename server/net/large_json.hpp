// LargeJson: JSON that takes long to parse is parsed beside the I/O thread, one text after another, so that heartbeats
// and other clients don't wait for it. One of it to an io_context.
//
// Invariant: at most kTextsMax large texts are in memory, from before the first byte is read until the request that
// came with the text is answered; who comes later waits unread.
#pragma once

#include <cstddef>
#include <deque>
#include <memory>
#include <optional>
#include <string>

#include <boost/asio/thread_pool.hpp>

#include "common/base/status.hpp"
#include "common/wire/message.hpp"
#include "server/net/asio.hpp"

namespace rcb::net {

class LargeJson : public asio::execution_context::service {
 public:
  using key_type = LargeJson;
  static asio::execution_context::id id;
  static constexpr std::size_t kBytesMin = std::size_t{64} << 10U;  // from which size on a text is large
  static constexpr int kTextsMax = 4;

  explicit LargeJson(asio::execution_context& context) : service(context) {}

  // A place among the texts in memory, until the last copy goes.
  using Place = std::shared_ptr<LargeJson>;
  awaitable<Place> take_place();
  // Parses on the other thread.
  awaitable<Result<wire::Json>> parse(const std::string& text);

 private:
  void shutdown() override;

  int places_taken_ = 0;
  std::deque<Timer*> waiting_;
  std::optional<asio::thread_pool> pool_;  // one thread, made at the first use
};

}  // namespace rcb::net
