#include "server/program/watchdog.hpp"

namespace rcb::server {

bool Watchdog::tick() {
  const std::uint64_t running = engine_.number_running();
  ticks_ = running != 0 && running == number_ ? ticks_ + 1 : 0;
  number_ = running;
  return running != 0 && seconds() > engine_.deadline_running_seconds() + stall_seconds_;
}

}  // namespace rcb::server
