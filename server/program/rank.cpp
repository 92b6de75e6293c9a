#include "server/program/rank.hpp"

#include <cstdio>
#include <utility>

#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include "server/net/peers/doorbell.hpp"
#include "server/program/job.hpp"
#include "server/program/watchdog.hpp"

namespace rcb::server {

void die(const std::string& why) {
  spdlog::critical("{}; this rank ends", why);
  remove_traces();
  ::_exit(1);
}

void watch(net::IoLoop& loop, const ranks::EngineLoop& engine, const Config& config, std::function<void()> beat) {
  loop.every(net::kTickSeconds, [beat = std::move(beat), dog = Watchdog(engine, config.stall_seconds)]() mutable {
    beat();
    spdlog::default_logger()->flush();
    if (dog.tick()) die(fmt::format("a command has run for {} s, far past its deadline", dog.seconds()));
  });
}

void say_failure(const Status& status) {
  std::fprintf(stderr, "rcbd: %s%s%s\n", status.message().c_str(), status.hint().empty() ? "" : "; ",
               status.hint().c_str());
}

}  // namespace rcb::server
