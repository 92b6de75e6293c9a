// Bridge: rank 0's engine as the sessions see it. Numbers each order, gives it to rank 0's engine and, unless rank 0
// can answer it alone, to all other ranks; returns the answer.
//
// Orders for all ranks may have to wait before they go out (net::OrderQueue); orders for rank 0 alone never wait.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "server/net/control/order_queue.hpp"
#include "server/net/data/data_port.hpp"
#include "server/net/peers/doorbell.hpp"
#include "server/net/push/engine.hpp"
#include "server/net/sockets/io_loop.hpp"
#include "server/ranks/engine_loop.hpp"

namespace rcb::server {

// Most orders in a rank's queue: as many as Credits lets through, besides the shutdown.
inline constexpr std::size_t kOrdersAheadMax = 128;
// After this many orders, and with every heartbeat, a rank reports how many it has executed.
inline constexpr std::uint64_t kExecutedReportEvery = 16;

class Bridge final : public net::Engine {
 public:
  Bridge(net::IoLoop& loop, ranks::EngineLoop& engine, net::DoorbellHub& doorbells, net::DataPort& data, int ranks);
  void submit(net::Order order, std::function<void(net::Answer)> done) override;
  void drop_cancelled() override { queue_.drop_cancelled(); }
  // I/O thread. `rank` has executed this many orders in all.
  void executed(int rank, std::uint64_t orders) { queue_.executed(rank, orders); }

 private:
  void send_to_all(net::Order&& order, net::OrderQueue::Done&& done, net::OrderQueue::Kind kind);
  // A rank that lacked an order would keep the others waiting for ever: what fails in here ends the process.
  void send_to_rank_0(net::Order order, std::vector<api::Slice> slices, net::OrderQueue::Done done) noexcept;
  void ring(const std::string& text) noexcept { doorbells_.ring(number_, text); }

  net::IoLoop& loop_;
  ranks::EngineLoop& engine_;
  net::DoorbellHub& doorbells_;
  net::DataPort& data_;
  net::OrderQueue queue_;
  std::uint64_t number_ = 0;
};

// What this rank has itself of the blocks of a push: the slices that came to it, and the memory that clients share.
// Empty if the order is no push. I/O thread.
std::vector<api::Slice> staged_slices(net::DataPort& data, const wire::Json& request);

}  // namespace rcb::server
