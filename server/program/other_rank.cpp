#include <atomic>
#include <memory>
#include <utility>

#include "common/base/clock.hpp"
#include "server/net/files/process_memory.hpp"
#include "server/net/peers/data_hub.hpp"
#include "server/net/peers/doorbell.hpp"
#include "server/program/direct_path.hpp"
#include "server/program/rank.hpp"

namespace rcb::server {
namespace {

ranks::EngineOrder order_from(net::DataPort& port, std::uint64_t number, wire::Json request) {
  ranks::EngineOrder order;
  order.number = number;
  const auto deadline =
      wire::number_field_or(request, "deadline_seconds", 0, wire::kDeadlineSecondsMax, wire::kDeadlineSecondsDefault);
  order.deadline_seconds = deadline.ok() ? *deadline : wire::kDeadlineSecondsMax;
  order.slices = staged_slices(port, request);
  order.request = std::move(request);
  return order;
}

}  // namespace

int run_other_rank(const RankSetup& setup) {
  ranks::MpiSession& mpi = setup.mpi;
  const std::string where = mpi.share({});
  if (where.empty()) return 1;  // rank 0 has told why
  const DirectPath path = share_direct_path(mpi, {});
  net::IoLoop loop;
  net::DataPort port(loop, data_options(setup, credentials_with(path.token), connection_limits(mpi.size())));
  // Declared after the loop: the engine's orders hold timers of the loop.
  std::unique_ptr<net::Doorbell> doorbell;
  std::atomic<std::uint64_t> executed = 0;
  const auto word = [&executed] { return wire::Json{{"executed", executed.load()}}; };
  ranks::EngineLoop engine(kQueueOrders, {.executed =
                                              [&] {
                                                if (++executed % kExecutedReportEvery == 0)
                                                  loop.post([&] { doorbell->tell(word()); });
                                              },
                                          .progress = [&mpi] { mpi.progress(); }});
  auto ordered = [&engine, &port](std::uint64_t number, wire::Json request) {
    RCB_CHECK(engine.push(order_from(port, number, std::move(request))), "the engine's queue is full");
  };
  auto connected = net::Doorbell::connect(loop, mpi.rank(), net::DoorbellAddress::parse(where),
                                          setup.hosts.with_root[static_cast<std::size_t>(mpi.rank())],
                                          setup.config.silence_seconds, ordered, die);
  if (!connected.ok()) die(connected.status().message());
  doorbell = std::move(*connected);
  open_direct_path(mpi, port, path.places, doorbell->local_address());
  doorbell->on_peer_message([&port](int, const wire::Json& message) { net::apply_hub_message(port, message); });
  port.start([&](const net::SliceReport& report) { doorbell->tell(net::report_json(report)); });
  watch(loop, engine, setup.config, [&] {
    wire::Json sign_of_life = word();
    sign_of_life["memory"] = net::resident_bytes();
    doorbell->tick(sign_of_life);
    port.tick();
  });
  loop.start();
  const SteadyClock clock;
  {
    service::Service service(mpi.comm(), clock, setup.service);
    engine.run(service);
  }
  loop.run([&] { port.finish(); });
  doorbell->finish(2 * kGoodbyeSeconds);
  loop.stop();
  mpi.finish(kFinalizeSeconds);
  return 0;
}

}  // namespace rcb::server
