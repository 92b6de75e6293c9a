// rcbd: wiring only. Rank 0 opens the sockets, tells the others through MPI where its doorbell is, and all ranks
// execute orders until one says shutdown.
#include <algorithm>
#include <atomic>
#include <csignal>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <sstream>
#include <vector>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include "common/base/clock.hpp"
#include "common/base/paths.hpp"
#include "common/base/socket_file.hpp"
#include "common/io/roots.hpp"
#include "server/bridge.hpp"
#include "server/config.hpp"
#include "server/job.hpp"
#include "server/net/control.hpp"
#include "server/net/data_directory.hpp"
#include "server/net/data_hub.hpp"
#include "server/net/doorbell.hpp"
#include "server/net/io_loop.hpp"
#include "server/net/log_sink.hpp"
#include "server/net/process_memory.hpp"
#include "server/ranks/engine_loop.hpp"
#include "server/ranks/mpi_session.hpp"
#include "server/service/report_file.hpp"

namespace rcb::server {
namespace {

constexpr double kStartSeconds = 30;
constexpr const char* kReportDirectory = "reports";  // in the data directory
constexpr double kGoodbyeSeconds = 5;
constexpr unsigned kFinalizeSeconds = 30;
// Rank 0 has at most the unfinished orders, the others those that credits let through; and the shutdown.
constexpr std::size_t kQueueOrders = std::max<std::size_t>(wire::kOrdersMax, kOrdersAheadMax) + 1;

// The other ranks can't be told any more; mpirun takes the job down when one rank ends like this.
[[noreturn]] void die(const std::string& why) {
  spdlog::critical("{}; this rank ends", why);
  remove_traces();
  ::_exit(1);
}

void set_up_log(const Config& config, int rank) {
  auto log = std::make_shared<spdlog::logger>("rcbd", std::make_shared<net::LogSink>(STDERR_FILENO));
  spdlog::set_default_logger(log);
  spdlog::set_level(spdlog::level::from_str(config.log_level));
  spdlog::set_pattern(fmt::format("%Y-%m-%dT%H:%M:%S.%e%z rank {} %l: %v", rank));
}

// Signals reach all ranks at once; only rank 0 acts on them, through its I/O thread.
void set_up_signals(int rank) {
  std::signal(SIGPIPE, SIG_IGN);
  if (ranks::started_by_mpirun()) end_with_mpirun(rank);
  if (rank == 0) return;
  for (const int number : {SIGTERM, SIGINT, SIGUSR1}) std::signal(number, SIG_IGN);
}

// The text that rank 0 shares: the token and, a line each, the places.
std::string data_text(const std::vector<std::string>& places, const std::string& token) {
  return fmt::format("{}\n{}", token, fmt::join(places, "\n"));
}

std::string host_of(const std::string& address) { return address.substr(0, address.rfind(':')); }

// Every rank: opens its listeners at the shared places and tells all ranks where they are.
// Returns by place, then by rank; a place where a rank couldn't listen has none. Collective.
std::vector<std::vector<std::string>> open_data(ranks::MpiSession& mpi, net::DataPort& port,
                                                const std::vector<std::string>& places) {
  std::string text;
  for (const std::string& place : places) {
    std::string address;
    Status status;
    if (place.starts_with("unix:")) {
      address = fmt::format("{}.{}", place, mpi.rank());
      status = port.listen_unix(address.substr(5));
    } else {
      auto bound = port.listen_tcp(place + ":0");
      status = bound.status();
      if (bound.ok()) address = *bound;
    }
    if (!status.ok()) spdlog::warn("no direct path at {}: {}", place, status.message());
    text += (status.ok() ? address : "") + "\n";
  }
  std::vector<std::byte> all;
  std::vector<std::size_t> sizes;
  mpi.comm().all_gather(std::as_bytes(std::span(text)), all, sizes);
  std::vector<std::vector<std::string>> found(places.size());
  const char* at = reinterpret_cast<const char*>(all.data());
  for (const std::size_t size : sizes) {
    std::istringstream lines(std::string(at, size));
    for (auto& addresses : found) std::getline(lines, addresses.emplace_back());
    at += size;
  }
  for (auto& addresses : found)
    if (std::find(addresses.begin(), addresses.end(), "") != addresses.end()) addresses.clear();
  return found;
}

// What rank 0 has and the others don't.
struct Root {
  std::vector<LockFile> endpoint_locks;  // unless its supervisor has them
  std::optional<net::DataDirectory> data;
  std::vector<net::OfferedToken> offered;
  std::unique_ptr<net::DoorbellHub> doorbells;
  std::unique_ptr<Bridge> bridge;
  std::unique_ptr<net::DataPort> port;
  std::unique_ptr<net::Control> control;
  std::unique_ptr<net::DataHub> hub;
  std::vector<std::string> endpoints;  // of the control listeners
  std::string token;
};

// What pushes may hold on this machine; the same rule for every rank's listeners.
std::uint64_t bulk_bytes(const Config& config) {
  return config.bulk_bytes != 0 ? config.bulk_bytes : net::bulk_bytes_default();
}

net::DataOptions data_options(const std::string& token, std::uint64_t bulk_bytes, int rank) {
  net::DataOptions options;
  options.rank = rank;
  options.token = token;
  options.bulk_bytes_max = bulk_bytes;
  return options;
}

// One service an endpoint; what a service that was killed has left of its sockets is removed.
Status take_endpoint(Root& root, const std::string& endpoint, EndpointNote note) {
  note.endpoint = endpoint;
  auto lock = rcb::take_endpoint(note);
  if (lock.ok())
    root.endpoint_locks.push_back(std::move(*lock));
  else if (!held_by_supervisor(endpoint_lock_path(endpoint)))
    return lock.status();
  if (endpoint.starts_with("unix:")) remove_dead_sockets(endpoint.substr(5));
  return {};
}

Status open_root(Root& root, const Config& config, int ranks, net::IoLoop& loop, ranks::EngineLoop& engine) {
  const std::string directory = config.data_dir.empty() ? data_directory_for(config.endpoint()) : config.data_dir;
  EndpointNote note;
  note.process = ProcessId::self();
  note.program = "rcbd";
  note.data_dir = directory;
  note.endpoint = config.endpoint();
  if (!config.socket.empty())
    if (Status status = take_endpoint(root, "unix:" + config.socket, note); !status.ok()) return status;
  for (const std::string& where : config.listen)
    if (!where.ends_with(":0"))
      if (Status status = take_endpoint(root, where, note); !status.ok()) return status;
  auto data = net::DataDirectory::open(directory, !config.data_dir.empty(), note);
  if (!data.ok()) return data.status();
  root.data.emplace(std::move(*data));
  net::ControlOptions options;
  options.version = RCB_VERSION;
  options.ranks = ranks;
  options.restarted = config.restarted;
  options.data_dir = root.data->path();
  options.bulk_bytes_max = bulk_bytes(config);
  options.network = config.trusted_network ? net::Network::trusted : net::Network::loopback;
  options.files_over_tcp = !config.files_below.empty();
  if (!config.listen.empty()) {
    auto token = config.restarted ? root.data->kept_token() : root.data->new_token();
    if (!token.ok()) return token.status();
    options.token = std::move(*token);
  }
  auto doorbells = net::DoorbellHub::open(loop, ranks, config.silence_seconds, die);
  if (!doorbells.ok()) return doorbells.status();
  root.doorbells = std::move(*doorbells);
  root.token = options.token;
  root.port = std::make_unique<net::DataPort>(loop, data_options(options.token, options.bulk_bytes_max, 0));
  root.bridge = std::make_unique<Bridge>(engine, *root.doorbells, *root.port, ranks);
  root.control = std::make_unique<net::Control>(loop, options, *root.bridge);
  if (!config.socket.empty()) {
    const Status status = root.control->listen_unix(config.socket);
    if (!status.ok()) return status;
    root.endpoints.push_back("unix:" + config.socket);
    spdlog::info("listening on unix:{}", config.socket);
  }
  for (const std::string& where : config.listen) {
    const auto bound = root.control->listen_tcp(where);
    if (!bound.ok()) return bound.status();
    root.endpoints.push_back(*bound);
    if (const std::string usual = data_directory_for(*bound); usual != root.data->path()) {
      auto offered = net::OfferedToken::offer(usual, options.token);
      if (!offered.ok()) return offered.status();
      root.offered.push_back(std::move(*offered));
    }
    spdlog::info("listening on {}, token in {}", *bound, join_path(root.data->path(), kTokenFile));
  }
  loop.on_signals([control = root.control.get()](int number) { control->shut_down(fmt::format("signal {}", number)); });
  return {};
}

void say_failure(const Status& status) {
  std::fprintf(stderr, "rcbd: %s%s%s\n", status.message().c_str(), status.hint().empty() ? "" : "; ",
               status.hint().c_str());
}

void watch(net::IoLoop& loop, const ranks::EngineLoop& engine, const Config& config, std::function<void()> beat) {
  loop.every(net::kTickSeconds, [beat = std::move(beat), dog = Watchdog(engine, config.stall_seconds)]() mutable {
    beat();
    spdlog::default_logger()->flush();
    if (dog.tick()) die(fmt::format("a command has run for {} s, far past its deadline", dog.seconds()));
  });
}

// Rank 0's part of making the direct path: its own listeners, and the addresses for clients. Collective.
void open_direct_path(Root& root, const Config& config, ranks::MpiSession& mpi, service::Loans& loans) {
  std::vector<std::string> places;
  if (!config.gateway_only)
    for (const std::string& endpoint : root.endpoints)
      places.push_back(endpoint.starts_with("unix:") ? endpoint : host_of(endpoint));
  mpi.share(data_text(places, root.token));
  const auto addresses = open_data(mpi, *root.port, places);
  root.hub = std::make_unique<net::DataHub>(*root.doorbells, *root.port, mpi.size());
  root.doorbells->on_news([&root](int rank, const wire::Json& news) {
    if (const auto orders = news.find("executed"); orders != news.end())
      root.bridge->executed(rank, orders->get<std::uint64_t>());
    if (const auto memory = news.find("memory"); memory != news.end())
      root.control->memory_reported(rank, memory->get<std::uint64_t>());
    if (news.contains("number")) root.control->slice_reported(rank, net::read_report(news));
  });
  root.control->ask_for_silence([&root] { return root.doorbells->silent(); });
  for (std::size_t i = 0; i < places.size(); ++i)
    if (!addresses[i].empty()) root.control->serve_data(*root.hub, root.endpoints[i], addresses[i]);
  root.port->start(
      [control = root.control.get()](const net::SliceReport& report) { control->slice_reported(0, report); },
      watch_arrivals(loans));
}

// The folders for clients' files, by rank 0's word. One that has gone by the time of a restart is no reason not to
// start. Collective.
Result<io::Roots> open_roots(const Config& config, ranks::MpiSession& mpi) {
  std::string names;
  for (const std::string& folder : config.files_below.empty() ? config.local_files_below : config.files_below)
    names.append(std::filesystem::absolute(folder).string()).push_back('\0');
  std::istringstream shared(mpi.share(names));
  io::Roots roots;
  for (std::string folder; std::getline(shared, folder, '\0');) {
    const Status opened = roots.add(folder);
    if (opened.ok()) continue;
    if (!config.restarted) return opened;
    if (mpi.rank() == 0) spdlog::warn("{}", opened.message());
  }
  return roots;
}

// Rank 0's. Without a place for older reports the service does its work, and says so where they are lost.
service::ServiceOptions root_options(const Config& config, const net::DataDirectory& data,
                                     service::ServiceOptions options) {
  options.keep_reports = config.keep_reports;
  const std::string directory = join_path(data.path(), kReportDirectory);
  if (const Status made = service::make_report_directory(directory); made.ok())
    options.report_directory = directory;
  else
    spdlog::warn("older step reports will be lost: {}", made.message());
  return options;
}

int run_root(const Config& config, ranks::MpiSession& mpi, service::NoSkip no_skip, const io::Roots& roots) {
  service::Loans loans;
  net::IoLoop loop;
  Root root;
  // Its orders hold timers of the loop.
  ranks::EngineLoop engine(kQueueOrders, {.spare = [&root](service::Spare spare) {
                             root.port->recycle(spare.scene, std::move(spare.buffers));
                           }});
  const Status opened = open_root(root, config, mpi.size(), loop, engine);
  if (!opened.ok()) say_failure(opened);
  mpi.share(opened.ok() ? root.doorbells->address().name : "refused");
  if (!opened.ok()) return 1;
  mpi.share(root.doorbells->address().secret);
  open_direct_path(root, config, mpi, loans);
  watch(loop, engine, config, [&root] {
    root.doorbells->tick();
    root.port->tick();
    root.control->tick();
  });
  loop.start();
  const Status connected = root.doorbells->wait_connected(kStartSeconds);
  if (!connected.ok()) die(connected.message());
  loop.run([&] { root.control->start(); });
  say_ready();
  spdlog::info("rcbd {} is up: {} ranks, pid {}{}", RCB_VERSION, mpi.size(), ::getpid(),
               config.restarted ? ", restarted and empty" : "");
  const SteadyClock clock;
  {
    service::Service service(mpi.comm(), clock,
                             root_options(config, *root.data, {.no_skip = no_skip, .loans = &loans, .roots = &roots}));
    engine.run(service);
  }
  // Its files have gone with the scenes.
  std::error_code ignored;
  std::filesystem::remove(join_path(root.data->path(), kReportDirectory), ignored);
  root.control->finish(kGoodbyeSeconds);
  loop.run([&] { root.port->finish(); });
  root.doorbells->finish(kGoodbyeSeconds);
  loop.stop();
  mpi.finish(kFinalizeSeconds);
  // The exit code says it too: a disk may be full, the directory gone.
  const Status marked = root.data->leave_clean_marker();
  if (!marked.ok()) spdlog::warn("no clean-shutdown marker: {}", marked.message());
  spdlog::info("ended cleanly");
  end_in_order();
  return 0;
}

int run_other(const Config& config, ranks::MpiSession& mpi, service::NoSkip no_skip, const io::Roots& roots) {
  net::DoorbellAddress address;
  address.name = mpi.share({});
  if (address.name == "refused") return 1;
  address.secret = mpi.share({});
  std::istringstream shared(mpi.share({}));
  std::string token;
  std::getline(shared, token);
  std::vector<std::string> places;
  for (std::string line; std::getline(shared, line);) places.push_back(line);
  service::Loans loans;
  net::IoLoop loop;
  net::DataPort port(loop, data_options(token, bulk_bytes(config), mpi.rank()));
  open_data(mpi, port, places);
  // Its orders hold timers of the loop.
  std::unique_ptr<net::Doorbell> doorbell;
  std::atomic<std::uint64_t> executed = 0;
  const auto word = [&executed] { return wire::Json{{"executed", executed.load()}}; };
  ranks::EngineLoop engine(
      kQueueOrders, {.spare = [&port](service::Spare spare) { port.recycle(spare.scene, std::move(spare.buffers)); },
                     .executed =
                         [&] {
                           if (++executed % kExecutedWordEvery == 0) loop.post([&] { doorbell->tell(word()); });
                         }});
  auto ordered = [&engine, &port](std::uint64_t number, wire::Json request) {
    ranks::EngineOrder order;
    order.number = number;
    const auto deadline =
        wire::number_field_or(request, "deadline_seconds", 0, wire::kDeadlineSecondsMax, wire::kDeadlineSecondsDefault);
    order.deadline_seconds = deadline.ok() ? *deadline : wire::kDeadlineSecondsMax;
    order.slices = staged_slices(port, request);
    order.request = std::move(request);
    CHECK(engine.push(std::move(order)), "the engine's queue is full");
  };
  auto connected = net::Doorbell::connect(loop, mpi.rank(), address, config.silence_seconds, ordered, die);
  if (!connected.ok()) die(connected.status().message());
  doorbell = std::move(*connected);
  doorbell->on_news([&port](int, const wire::Json& news) { net::follow_hub(port, news); });
  port.start([&](const net::SliceReport& report) { doorbell->tell(net::report_json(report)); }, watch_arrivals(loans));
  watch(loop, engine, config, [&] {
    wire::Json sign_of_life = word();
    sign_of_life["memory"] = net::resident_bytes();
    doorbell->tick(sign_of_life);
    port.tick();
  });
  loop.start();
  const SteadyClock clock;
  {
    service::Service service(mpi.comm(), clock, {.no_skip = no_skip, .loans = &loans, .roots = &roots});
    engine.run(service);
  }
  loop.run([&] { port.finish(); });
  doorbell->finish(2 * kGoodbyeSeconds);
  loop.stop();
  mpi.finish(kFinalizeSeconds);
  return 0;
}

int run(int argc, char** argv) {
  const ParsedConfig parsed = parse_config(argc, argv);
  if (!parsed.run) {
    if (ranks::rank_from_environment() != 0) return parsed.exit_code;
    std::fputs(parsed.out.c_str(), stdout);
    std::fputs(parsed.error.c_str(), stderr);
    return parsed.exit_code;
  }
  set_up_signals(ranks::rank_from_environment());
  auto mpi = ranks::MpiSession::start(&argc, &argv);
  if (!mpi.ok()) {
    if (ranks::rank_from_environment() == 0) say_failure(mpi.status());
    return 1;
  }
  set_up_log(parsed.config, mpi->rank());
  set_check_context(fmt::format("rank {} of {}", mpi->rank(), mpi->size()));
  // Rank 0's word counts: what ranks do must match.
  const std::string names = mpi->share(parsed.config.no_skip);
  const auto no_skip = service::NoSkip::parse(names);
  CHECK(no_skip.ok(), no_skip.status().message());
  if (!names.empty() && mpi->rank() == 0) spdlog::warn("for measurement only: '{}' isn't skipped", names);
  const auto roots = open_roots(parsed.config, *mpi);
  if (!roots.ok()) {
    if (mpi->rank() == 0) say_failure(roots.status());
    return 1;
  }
  return mpi->rank() == 0 ? run_root(parsed.config, *mpi, *no_skip, *roots)
                          : run_other(parsed.config, *mpi, *no_skip, *roots);
}

}  // namespace
}  // namespace rcb::server

int main(int argc, char** argv) { return rcb::server::run(argc, argv); }
