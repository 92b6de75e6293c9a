// Bridge: rank 0's engine as the sessions see it. An order gets its number here, goes to all ranks, and its answer
// comes back.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "server/net/data_port.hpp"
#include "server/net/doorbell.hpp"
#include "server/net/engine.hpp"
#include "server/ranks/engine_loop.hpp"
#include "server/service/arrival.hpp"

namespace rcb::server {

class Bridge final : public net::Engine {
 public:
  Bridge(ranks::EngineLoop& engine, net::DoorbellHub& doorbells, net::DataPort& data)
      : engine_(engine), doorbells_(doorbells), data_(data) {}
  void submit(net::Order order, std::function<void(net::Answer)> done) override;

 private:
  ranks::EngineLoop& engine_;
  net::DoorbellHub& doorbells_;
  net::DataPort& data_;
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
