// Watchdog: detects an engine that is so far past its order's deadline that it will never finish; the caller then ends
// the process. It counts ticks (one every kTickSeconds), so that a machine that was suspended isn't taken for a stalled
// engine.
#pragma once

#include <cstdint>

#include "server/net/peers/doorbell.hpp"
#include "server/ranks/engine_loop.hpp"

namespace rcb::server {

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
