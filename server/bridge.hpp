// Bridge: rank 0's engine as the sessions see it. An order gets its number here, goes to rank 0's engine and, unless
// that one can answer it alone, to all other ranks; its answer comes back.
//
// Invariant: orders for all ranks go out in the order of submit(). They wait here while a rank is too far behind
// (net::Credits); what rank 0 answers alone doesn't.
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <string>
#include <vector>

#include "server/net/credits.hpp"
#include "server/net/data_port.hpp"
#include "server/net/doorbell.hpp"
#include "server/net/engine.hpp"
#include "server/ranks/engine_loop.hpp"
#include "server/service/arrival.hpp"

namespace rcb::server {

// Orders that a rank may have in its queue: those that Credits lets through, and the shutdown.
inline constexpr std::size_t kOrdersAheadMax = 128;
// A rank says after so many orders, and with every sign of life, how many it has executed.
inline constexpr std::uint64_t kExecutedWordEvery = 16;

class Bridge final : public net::Engine {
 public:
  Bridge(ranks::EngineLoop& engine, net::DoorbellHub& doorbells, net::DataPort& data, int ranks);
  void submit(net::Order order, std::function<void(net::Answer)> done) override;
  // I/O thread. The rank has executed so many orders in all.
  void executed(int rank, std::uint64_t orders);

 private:
  struct Waiting {
    net::Order order;
    std::function<void(net::Answer)> done;
    bool on_all_ranks = true;
  };
  bool may_go(const Waiting& next) const { return credits_.room(next.order.text.size()); }
  void send(Waiting next);

  ranks::EngineLoop& engine_;
  net::DoorbellHub& doorbells_;
  net::DataPort& data_;
  net::Credits credits_;
  std::deque<Waiting> waiting_;  // at most as many as the coordinator lets be unfinished
  std::uint64_t number_ = 0;
};

// Lets the engine's service see slices as they come.
net::DataPort::Watch watch_arrivals(service::Loans& loans);

// The slice that this rank received for an order, if the order is of a direct push, or what members' pushes brought it,
// each with its member for a rank. On the I/O thread.
std::vector<service::PushSlice> staged_slices(net::DataPort& data, const wire::Json& request);

// Ends the process if the engine is so far past its order's deadline that it will never come back. Called every
// kTickSeconds; counts ticks, so a machine that was asleep is not taken for a stalled engine.
class Watchdog {
 public:
  Watchdog(const ranks::EngineLoop& engine, double stall_seconds) : engine_(engine), stall_seconds_(stall_seconds) {}
  // True if the engine is stalled.
  bool tick();
  double seconds() const { return ticks_ * net::kTickSeconds; }

 private:
  const ranks::EngineLoop& engine_;
  double stall_seconds_;
  std::uint64_t number_ = 0;
  int ticks_ = 0;
};

}  // namespace rcb::server
