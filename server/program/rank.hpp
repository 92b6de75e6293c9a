// What a rank of the service does from its first collective to its last: rank 0, which has the endpoints, and the
// others.
#pragma once

#include <functional>
#include <string>

#include "server/net/sockets/io_loop.hpp"
#include "server/program/bridge.hpp"
#include "server/program/config.hpp"
#include "server/program/hosts.hpp"
#include "server/ranks/engine_loop.hpp"
#include "server/ranks/mpi_session.hpp"
#include "server/service/service.hpp"

namespace rcb::server {

// What a rank knows when it begins.
struct RankSetup {
  const Config& config;
  ranks::MpiSession& mpi;
  const Hosts& hosts;
  service::ServiceOptions service;
};

// Collective, run_rank_0 on rank 0 and run_other_rank on the others. Both return when the service has ended: the
// process's exit code.
int run_rank_0(const RankSetup& setup);
int run_other_rank(const RankSetup& setup);

// For both kinds.

inline constexpr double kGoodbyeSeconds = 5;
inline constexpr unsigned kFinalizeSeconds = 30;
// Rank 0's queue holds at most the unfinished orders, the other ranks' those that the credits let through; one more is
// for the shutdown.
inline constexpr std::size_t kQueueOrders = std::max<std::size_t>(wire::kOrdersMax, kOrdersAheadMax) + 1;

// The other ranks can't be told any more, but mpirun ends the job when one rank ends like this.
[[noreturn]] void die(const std::string& why);

// Every kTickSeconds, on the I/O thread: calls `beat`, and ends the process if the engine is stalled.
void watch(net::IoLoop& loop, const ranks::EngineLoop& engine, const Config& config, std::function<void()> beat);

// On standard error, for whoever starts the service.
void say_failure(const Status& status);

}  // namespace rcb::server
