#include "server/net/sockets/large_json.hpp"

#include <algorithm>

#include <boost/asio/this_coro.hpp>

namespace rcb::net {

asio::execution_context::id LargeJson::id;

awaitable<LargeJson::Place> LargeJson::take_place() {
  while (places_taken_ >= kTextsMax) {
    Timer timer(co_await asio::this_coro::executor, TimePoint::max());
    waiting_.push_back(&timer);
    co_await timer.async_wait(kAwait);
    std::erase(waiting_, &timer);
  }
  ++places_taken_;
  co_return Place(this, [](LargeJson* of) {
    --of->places_taken_;
    if (!of->waiting_.empty()) of->waiting_.front()->cancel();
  });
}

awaitable<Result<wire::Json>> LargeJson::parse(const std::string& text) {
  if (!pool_) pool_.emplace(1);
  std::optional<Result<wire::Json>> parsed;
  // This coroutine resumes on the I/O thread when the one on the pool has ended.
  co_await asio::co_spawn(
      *pool_,
      [&text, &parsed]() -> awaitable<void> {
        parsed.emplace(wire::parse_json(text));
        co_return;
      },
      asio::use_awaitable);
  co_return std::move(*parsed);
}

void LargeJson::shutdown() {
  if (pool_) pool_->join();
}

}  // namespace rcb::net
