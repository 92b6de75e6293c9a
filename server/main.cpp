// rcbd's main program: connects the components. Rank 0 opens the sockets and tells the others through MPI where its
// doorbell listens; then all ranks execute orders until the shutdown.
#include <algorithm>
#include <atomic>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <optional>
#include <set>
#include <span>
#include <sstream>
#include <vector>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include "common/auth/proof.hpp"
#include "common/base/clock.hpp"
#include "common/files/paths.hpp"
#include "common/files/socket_file.hpp"
#include "common/io/files/roots.hpp"
#include "common/tls/identity.hpp"
#include "server/bridge.hpp"
#include "server/config.hpp"
#include "server/job.hpp"
#include "server/net/control/control.hpp"
#include "server/net/files/data_directory.hpp"
#include "server/net/files/log_sink.hpp"
#include "server/net/files/process_memory.hpp"
#include "server/net/peers/data_hub.hpp"
#include "server/net/peers/doorbell.hpp"
#include "server/net/peers/host.hpp"
#include "server/net/sockets/io_loop.hpp"
#include "server/ranks/engine_loop.hpp"
#include "server/ranks/mpi_session.hpp"
#include "server/service/scene/report_file.hpp"

namespace rcb::server {
namespace {

constexpr double kStartSeconds = 30;
constexpr const char* kReportDirectory = "reports";  // inside the data directory
constexpr double kGoodbyeSeconds = 5;
constexpr unsigned kFinalizeSeconds = 30;
// Rank 0's queue holds at most the unfinished orders, the other ranks' those that the credits let through; one more is
// for the shutdown.
constexpr std::size_t kQueueOrders = std::max<std::size_t>(wire::kOrdersMax, kOrdersAheadMax) + 1;

// The other ranks can't be told any more, but mpirun ends the job when one rank ends like this.
[[noreturn]] void die(const std::string& why) {
  spdlog::critical("{}; this rank ends", why);
  remove_traces();
  ::_exit(1);
}

// Which machines the ranks run on.
struct Hosts {
  std::vector<net::RankHost> ranks;
  std::vector<bool> with_root;  // by rank: on rank 0's machine
  bool several = false;

  std::vector<std::string> names() const {
    std::vector<std::string> list;
    for (const net::RankHost& rank : ranks) list.push_back(rank.host);
    return list;
  }
};

// Collective.
Hosts find_hosts(ranks::MpiSession& mpi) {
  const net::Host here = net::Host::here();
  Hosts hosts;
  std::string key_of_root;
  for (const std::string& text :
       mpi.gather(wire::Json{{"name", here.name}, {"key", here.key}, {"pid", ::getpid()}}.dump())) {
    const wire::Json one = wire::Json::parse(text);
    const std::string key = one.at("key").get<std::string>();
    if (hosts.ranks.empty()) key_of_root = key;
    hosts.ranks.push_back({one.at("name").get<std::string>(), one.at("pid").get<std::int64_t>()});
    hosts.with_root.push_back(key == key_of_root);
    hosts.several = hosts.several || key != key_of_root;
  }
  return hosts;
}

void set_log_pattern(const std::string& who) {
  spdlog::set_pattern(fmt::format("%Y-%m-%dT%H:%M:%S.%e%z {} %l: %v", who));
}

void set_up_log(const Config& config, int rank) {
  auto log = std::make_shared<spdlog::logger>("rcbd", std::make_shared<net::LogSink>(STDERR_FILENO));
  spdlog::set_default_logger(log);
  spdlog::set_level(spdlog::level::from_str(config.log_level));
  set_log_pattern(fmt::format("rank {}", rank));
}

// Signals reach all ranks at once; only rank 0 acts on them, through its I/O thread.
void set_up_signals(int rank) {
  // A write that fails tells why; it ends no process.
  std::signal(SIGPIPE, SIG_IGN);
  std::signal(SIGXFSZ, SIG_IGN);
  if (ranks::started_by_mpirun()) end_with_mpirun(rank);
  if (rank == 0) return;
  for (const int number : {SIGTERM, SIGINT, SIGUSR1}) std::signal(number, SIG_IGN);
}

// The text that rank 0 shares with all ranks: the token, then the places at which ranks listen, one a line.
std::string data_text(const std::vector<std::string>& places, const std::string& token) {
  return fmt::format("{}\n{}", token, fmt::join(places, "\n"));
}

std::string host_of(const std::string& address) { return address.substr(0, address.rfind(':')); }

// Where this rank listens for the clients of an endpoint: at its place, or, if that is on another machine's network
// interface, at this machine's own. Errors: unsupported, if the endpoint's clients can't reach this machine.
Result<std::string> listen_at(net::DataPort& port, const std::string& place, int rank, const std::string& elsewhere) {
  const bool is_unix = place.starts_with("unix:");
  if (!elsewhere.empty() && (place.starts_with("127.") || place == "[::1]"))  // its clients may come through a tunnel
    return Status(Code::unsupported,
                  fmt::format("rank {} is on another machine, and clients here push by way of rank 0", rank));
  if (!is_unix || !elsewhere.empty())
    return port.listen_tcp(elsewhere.empty() ? place + ":0" : net::with_port(elsewhere, 0));
  const std::string address = fmt::format("{}.{}", place, rank);
  if (Status status = port.listen_unix(address.substr(5)); !status.ok()) return status;
  return address;
}

// Collective. Every rank opens its listeners at the shared places, and all ranks learn their addresses. Returns the
// addresses by place, then by rank; none for a place where some rank couldn't listen. elsewhere: the address of this
// machine, if it isn't rank 0's.
std::vector<std::vector<std::string>> open_data(ranks::MpiSession& mpi, net::DataPort& port,
                                                const std::vector<std::string>& places, const std::string& elsewhere) {
  std::string text;
  for (const std::string& place : places) {
    const Result<std::string> address = listen_at(port, place, mpi.rank(), elsewhere);
    if (!address.ok()) spdlog::warn("no direct path at {}: {}", place, address.status().message());
    text += (address.ok() ? *address : "") + "\n";
  }
  std::vector<std::vector<std::string>> found(places.size());
  for (const std::string& of_rank : mpi.gather(text)) {
    std::istringstream lines(of_rank);
    for (auto& addresses : found) std::getline(lines, addresses.emplace_back());
  }
  for (auto& addresses : found)
    if (std::find(addresses.begin(), addresses.end(), "") != addresses.end()) addresses.clear();
  return found;
}

// What only rank 0 has.
struct Root {
  std::vector<LockFile> endpoint_locks;  // unless its supervisor holds them
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

// The limit on the bytes of all pushes together; the same for every rank's listeners.
std::uint64_t bulk_bytes(const Config& config) {
  return config.bulk_bytes != 0 ? config.bulk_bytes : net::bulk_bytes_default();
}

// Every process has a certificate of its own, which the token's proofs are bound to.
net::Credentials credentials_with(std::string token) {
  net::Credentials credentials{std::move(token), {}};
  if (credentials.token.empty() || auth::trusts_network(credentials.token)) return credentials;
  auto identity = tls::Identity::make();
  if (identity.ok())
    credentials.identity = std::move(*identity);
  else
    spdlog::warn("{}; so no other machine may connect", identity.status().message());
  return credentials;
}

net::DataOptions data_options(net::Credentials credentials, std::uint64_t bulk_bytes, int rank,
                              const ConnectionLimits& limits) {
  net::DataOptions options;
  options.connections_max = limits.sessions;
  options.waiting_max = limits.waiting;
  options.rank = rank;
  options.credentials = std::move(credentials);
  options.bulk_bytes_max = bulk_bytes;
  return options;
}

// Locks the endpoint, so that one service serves it, and removes the sockets left by a service that was killed.
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

// What was started here must be reached here: rank 0 listens where its launcher waits for it. And what travels between
// machines can be read there: MPI's messages, the token among them.
Status check_hosts(const Hosts& hosts, const Config& config) {
  if (hosts.several && !config.trusted_network && !config.trusted_interconnect)
    return {
        Code::invalid_argument,
        fmt::format("ranks would run on {} and on other machines, and MPI doesn't encrypt what travels between them: "
                    "who is on that network can read and alter positions and commands",
                    hosts.ranks[0].host),
        "say with --trusted-network that nobody on the network is to be feared, or with --trusted-interconnect that "
        "this holds between the ranks; then clients' connections are encrypted"};
  const char* launcher = std::getenv(kLauncherHostVariable);
  if (launcher == nullptr || hosts.ranks[0].host == launcher) return {};
  return {
      Code::invalid_argument,
      fmt::format("rank 0 would run on {}, but 'rcbctl up' was run on {}", hosts.ranks[0].host, launcher),
      "name this machine first among the hosts; in a batch job, run it on the first of the job's machines, such as in "
      "the job's script"};
}

// Puts the token where clients on this machine look for it: they name the endpoint by the address, or as it was given.
Status offer_token(Root& root, const std::string& given, const std::string& bound) {
  std::set<std::string> directories{data_directory_for(bound)};
  if (!given.ends_with(":0")) directories.insert(data_directory_for(given));
  directories.erase(root.data->path());
  for (const std::string& directory : directories) {
    auto offered = net::OfferedToken::offer(directory, root.token);
    if (!offered.ok()) return offered.status();
    root.offered.push_back(std::move(*offered));
  }
  return {};
}

Status open_root(Root& root, const Config& config, const Hosts& hosts, net::IoLoop& loop, ranks::EngineLoop& engine) {
  const int ranks = static_cast<int>(hosts.ranks.size());
  if (Status status = check_hosts(hosts, config); !status.ok()) return status;
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
  options.hosts = hosts.ranks;
  options.restarted = config.restarted;
  options.data_dir = root.data->path();
  options.bulk_bytes_max = bulk_bytes(config);
  const ConnectionLimits limits = connection_limits(ranks);
  options.sessions_max = limits.sessions;
  options.waiting_max = limits.waiting;
  options.files_over_tcp = !config.files_below.empty();
  if (!config.listen.empty() || hosts.several) {
    const std::string_view prefix = config.trusted_network ? auth::kTrustedNetworkPrefix : std::string_view();
    auto token = config.restarted ? root.data->kept_token(prefix) : root.data->new_token(prefix);
    if (!token.ok()) return token.status();
    options.credentials = credentials_with(std::move(*token));
  }
  auto doorbells = net::DoorbellHub::open(loop,
                                          {.ranks = ranks,
                                           .silence_seconds = config.silence_seconds,
                                           .hosts = hosts.several ? hosts.names() : std::vector<std::string>(),
                                           .interface = config.interface},
                                          die);
  if (!doorbells.ok()) return doorbells.status();
  root.doorbells = std::move(*doorbells);
  root.token = options.credentials.token;
  root.port =
      std::make_unique<net::DataPort>(loop, data_options(options.credentials, options.bulk_bytes_max, 0, limits));
  root.bridge = std::make_unique<Bridge>(loop, engine, *root.doorbells, *root.port, ranks);
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
    if (hosts.several && bound->starts_with("127.") && !where.starts_with("127."))
      return {Code::invalid_argument,
              fmt::format("--listen {} is {} on this machine, which no other reaches", where, *bound),
              "give the machine's address on the network"};
    if (Status status = offer_token(root, where, *bound); !status.ok()) return status;
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

// Collective. Opens the direct path (clients' connections to the ranks) on rank 0: its own listeners, and the addresses
// for clients.
void open_direct_path(Root& root, const Config& config, ranks::MpiSession& mpi) {
  std::vector<std::string> places;
  if (!config.gateway_only)
    for (const std::string& endpoint : root.endpoints)
      places.push_back(endpoint.starts_with("unix:") ? endpoint : host_of(endpoint));
  mpi.share(data_text(places, root.token));
  const auto addresses = open_data(mpi, *root.port, places, {});
  root.hub = std::make_unique<net::DataHub>(*root.doorbells, *root.port, mpi.size());
  root.doorbells->on_peer_message([&root](int rank, const wire::Json& message) {
    if (const auto orders = message.find("executed"); orders != message.end())
      root.bridge->executed(rank, orders->get<std::uint64_t>());
    if (const auto memory = message.find("memory"); memory != message.end())
      root.control->memory_reported(rank, memory->get<std::uint64_t>());
    if (message.contains("number")) root.control->slice_reported(rank, net::read_report(message));
  });
  root.control->set_silence_query([&root] { return root.doorbells->silent(); });
  for (std::size_t i = 0; i < places.size(); ++i)
    if (!addresses[i].empty()) root.control->serve_data(*root.hub, root.endpoints[i], addresses[i]);
  root.port->start(
      [control = root.control.get()](const net::SliceReport& report) { control->slice_reported(0, report); });
}

// Collective. The folders for clients' files, as rank 0's options name them, which all ranks must have. After a restart
// a folder that no longer exists is only warned about, and so is the default folder where machines don't share it.
Result<io::Roots> open_roots(const Config& config, ranks::MpiSession& mpi, const Hosts& hosts) {
  std::string names;
  for (const std::string& folder : config.files_below.empty() ? config.local_files_below : config.files_below)
    names.append(std::filesystem::absolute(folder).string()).push_back('\0');
  std::istringstream shared(mpi.share(names));
  io::Roots roots;
  // Rank 0's word, since the other machines don't know of a restart.
  const bool may_fail =
      mpi.share(config.restarted || (hosts.several && config.files_below.empty()) ? "warn" : "refuse") == "warn";
  for (std::string folder; std::getline(shared, folder, '\0');) {
    const Status opened = io::Roots().add(folder);
    const std::vector<std::string> faults = mpi.gather(opened.message());
    const auto fault =
        std::find_if(faults.begin(), faults.end(), [](const std::string& text) { return !text.empty(); });
    if (fault == faults.end()) {
      if (Status added = roots.add(folder); !added.ok()) return added;
      continue;
    }
    const std::string& host = hosts.ranks[static_cast<std::size_t>(fault - faults.begin())].host;
    const std::string what = hosts.several ? fmt::format("on {}: {}", host, *fault) : *fault;
    if (!may_fail) return Status(Code::io_error, what, opened.hint());
    if (mpi.rank() == 0) spdlog::warn("clients can't name files below {}: {}", folder, what);
  }
  return roots;
}

// Rank 0's options. If the directory for older reports can't be made, the service runs all the same, and the history
// says that older ones are lost.
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

int run_root(const Config& config, ranks::MpiSession& mpi, const Hosts& hosts, service::NoSkip no_skip,
             const io::Roots& roots) {
  net::IoLoop loop;
  Root root;
  // Declared after the loop: the engine's orders hold timers of the loop.
  ranks::EngineLoop engine(kQueueOrders, {.spare = [&root](service::Spare spare) {
                             root.port->recycle(spare.scene, std::move(spare.buffers));
                           }});
  const Status opened = open_root(root, config, hosts, loop, engine);
  if (!opened.ok()) say_failure(opened);
  mpi.share(opened.ok() ? root.doorbells->address().text() : "refused");
  if (!opened.ok()) return 1;
  open_direct_path(root, config, mpi);
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
    service::Service service(
        mpi.comm(), clock,
        root_options(config, *root.data, {.no_skip = no_skip, .roots = &roots, .bulk_bytes_max = bulk_bytes(config)}));
    engine.run(service);
  }
  // Empty by now: the scenes' report files were removed with the scenes.
  std::error_code ignored;
  std::filesystem::remove(join_path(root.data->path(), kReportDirectory), ignored);
  root.control->finish(kGoodbyeSeconds);
  loop.run([&] { root.port->finish(); });
  root.doorbells->finish(kGoodbyeSeconds);
  loop.stop();
  mpi.finish(kFinalizeSeconds);
  // A failure is harmless (a full disk, say): the exit code tells a clean end, too.
  const Status marked = root.data->leave_clean_marker();
  if (!marked.ok()) spdlog::warn("no clean-shutdown marker: {}", marked.message());
  spdlog::info("ended cleanly");
  end_in_order();
  return 0;
}

int run_other(const Config& config, ranks::MpiSession& mpi, const Hosts& hosts, service::NoSkip no_skip,
              const io::Roots& roots) {
  const std::string where = mpi.share({});
  if (where == "refused") return 1;
  std::istringstream shared(mpi.share({}));
  std::string token;
  std::getline(shared, token);
  std::vector<std::string> places;
  for (std::string line; std::getline(shared, line);) places.push_back(line);
  net::IoLoop loop;
  net::DataPort port(
      loop, data_options(credentials_with(token), bulk_bytes(config), mpi.rank(), connection_limits(mpi.size())));
  // Declared after the loop: the engine's orders hold timers of the loop.
  std::unique_ptr<net::Doorbell> doorbell;
  std::atomic<std::uint64_t> executed = 0;
  const auto word = [&executed] { return wire::Json{{"executed", executed.load()}}; };
  ranks::EngineLoop engine(
      kQueueOrders, {.spare = [&port](service::Spare spare) { port.recycle(spare.scene, std::move(spare.buffers)); },
                     .executed =
                         [&] {
                           if (++executed % kExecutedReportEvery == 0) loop.post([&] { doorbell->tell(word()); });
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
  auto connected = net::Doorbell::connect(loop, mpi.rank(), net::DoorbellAddress::parse(where),
                                          hosts.with_root[static_cast<std::size_t>(mpi.rank())], config.silence_seconds,
                                          ordered, die);
  if (!connected.ok()) die(connected.status().message());
  doorbell = std::move(*connected);
  open_data(mpi, port, places, doorbell->local_address());
  doorbell->on_peer_message([&port](int, const wire::Json& message) { net::apply_hub_message(port, message); });
  port.start([&](const net::SliceReport& report) { doorbell->tell(net::report_json(report)); });
  watch(loop, engine, config, [&] {
    wire::Json sign_of_life = word();
    sign_of_life["memory"] = net::resident_bytes();
    doorbell->tick(sign_of_life);
    port.tick();
  });
  loop.start();
  const SteadyClock clock;
  {
    service::Service service(mpi.comm(), clock,
                             {.no_skip = no_skip, .roots = &roots, .bulk_bytes_max = bulk_bytes(config)});
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
    // Another machine may refuse what rank 0's takes.
    const char* launcher = std::getenv(kLauncherHostVariable);
    if (ranks::rank_from_environment() != 0 && launcher != nullptr && host_name() != launcher)
      std::fprintf(stderr, "on %s: %s", host_name().c_str(), parsed.error.c_str());
    if (ranks::rank_from_environment() != 0) return parsed.exit_code;
    std::fputs(parsed.out.c_str(), stdout);
    std::fputs(parsed.error.c_str(), stderr);
    return parsed.exit_code;
  }
  raise_open_files_limit();
  set_up_signals(ranks::rank_from_environment());
  auto mpi = ranks::MpiSession::start(&argc, &argv);
  if (!mpi.ok()) {
    if (ranks::rank_from_environment() == 0) say_failure(mpi.status());
    return 1;
  }
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)  // which tell more
  end_at_faults(mpi->rank());
#endif
  set_up_log(parsed.config, mpi->rank());
  set_check_context(fmt::format("rank {} of {}", mpi->rank(), mpi->size()));
  // Rank 0's option applies to all ranks, since their collectives must match.
  const std::string names = mpi->share(parsed.config.no_skip);
  const auto no_skip = service::NoSkip::parse(names);
  CHECK(no_skip.ok(), no_skip.status().message());
  if (!names.empty() && mpi->rank() == 0) spdlog::warn("for measurement only: '{}' isn't skipped", names);
  const Hosts hosts = find_hosts(*mpi);
  if (hosts.several)
    set_log_pattern(fmt::format("{} rank {}", hosts.ranks[static_cast<std::size_t>(mpi->rank())].host, mpi->rank()));
  const auto roots = open_roots(parsed.config, *mpi, hosts);
  if (!roots.ok()) {
    if (mpi->rank() == 0) say_failure(roots.status());
    return 1;
  }
  return mpi->rank() == 0 ? run_root(parsed.config, *mpi, hosts, *no_skip, *roots)
                          : run_other(parsed.config, *mpi, hosts, *no_skip, *roots);
}

}  // namespace
}  // namespace rcb::server

int main(int argc, char** argv) { return rcb::server::run(argc, argv); }
