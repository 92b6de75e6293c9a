#include "server/net/sockets/large_json.hpp"

#include <boost/asio/this_coro.hpp>

namespace rcb::net {

asio::execution_context::id LargeJson::id;

awaitable<LargeJson::Place> LargeJson::take_place() {
  while (places_taken_ >= kTextsMax) co_await place_freed_.async_wait(kAwait);
  ++places_taken_;
  co_return Place(this, [](LargeJson* of) {
    --of->places_taken_;
    // Places that are freed one after the other, before anybody has run, must each wake somebody: so all are woken, and
    // those who find no place wait on.
    of->place_freed_.cancel();
  });
}

awaitable<Result<wire::Json>> LargeJson::parse(std::string text) {
  const auto executor = co_await asio::this_coro::executor;
  // All three are the thread's as well, which may be at work when this coroutine is destroyed.
  auto parsed = std::make_shared<std::optional<Result<wire::Json>>>();
  auto done = std::make_shared<Timer>(executor, TimePoint::max());
  const auto shared = std::make_shared<const std::string>(std::move(text));
  const Status begun = thread_->post([parsed, shared] { parsed->emplace(wire::parse_json(*shared)); },
                                     [parsed, done, executor] { asio::post(executor, [done] { done->cancel(); }); });
  if (!begun.ok()) co_return wire::parse_json(*shared);
  co_await done->async_wait(kAwait);
  if (!*parsed) co_return Status(Code::too_large, "no memory for the JSON of this message");
  co_return std::move(**parsed);
}

}  // namespace rcb::net
