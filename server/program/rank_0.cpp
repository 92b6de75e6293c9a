#include <filesystem>
#include <memory>
#include <optional>
#include <set>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include "common/auth/proof.hpp"
#include "common/base/clock.hpp"
#include "common/files/paths.hpp"
#include "common/files/socket_file.hpp"
#include "server/net/control/control.hpp"
#include "server/net/files/data_directory.hpp"
#include "server/net/peers/data_hub.hpp"
#include "server/net/peers/doorbell.hpp"
#include "server/program/direct_path.hpp"
#include "server/program/job.hpp"
#include "server/program/rank.hpp"
#include "server/scene/journal.hpp"

namespace rcb::server {
namespace {

constexpr double kStartSeconds = 30;

std::string host_of(const std::string& address) { return address.substr(0, address.rfind(':')); }

// The sockets and files that only rank 0 has.
class Rank0 {
 public:
  explicit Rank0(const RankSetup& setup)
      : setup_(setup), engine_(kQueueOrders, {.progress = [this] { setup_.mpi.progress(); }}) {}

  // Local. Opens the endpoints, and where the other ranks connect.
  Status open();
  // Where the other ranks connect, after open().
  std::string doorbell_address() const { return doorbells_->address().text(); }
  // Collective. Opens the ranks' listeners for clients, and tells clients of them.
  void open_direct_path();
  // Collective. Serves until a command or signal ends the service.
  void serve();

 private:
  Status lock_endpoints(EndpointNote note);
  Status lock_endpoint(const std::string& endpoint, EndpointNote note);
  Status open_data_directory();
  Status open_credentials();
  Status listen();
  Status listen_tcp(const std::string& where);
  Status offer_token(const std::string& given, const std::string& bound);
  net::ControlOptions control_options(const ConnectionLimits& limits) const;
  void run_engine();
  void finish();

  const RankSetup& setup_;
  net::IoLoop loop_;
  std::vector<LockFile> endpoint_locks_;  // unless its supervisor holds them
  std::optional<net::DataDirectory> data_;
  std::shared_ptr<scene::Storage> storage_ = scene::disk_storage();
  net::Credentials credentials_;
  std::vector<net::OfferedToken> offered_;
  std::unique_ptr<net::DoorbellHub> doorbells_;
  std::unique_ptr<net::DataPort> port_;
  std::unique_ptr<Bridge> bridge_;
  std::unique_ptr<net::Control> control_;
  std::unique_ptr<net::DataHub> hub_;
  std::vector<std::string> endpoints_;  // of the control listeners
  ranks::EngineLoop engine_;            // last, since its orders hold timers of the loop and buffers of the port
};

Status Rank0::open() {
  if (Status status = check_hosts(setup_.hosts, setup_.config); !status.ok()) return status;
  if (Status status = open_data_directory(); !status.ok()) return status;
  if (Status status = open_credentials(); !status.ok()) return status;
  const bool several = setup_.hosts.several;
  auto doorbells = net::DoorbellHub::open(loop_,
                                          {.ranks = setup_.mpi.size(),
                                           .silence_seconds = setup_.config.silence_seconds,
                                           .hosts = several ? setup_.hosts.names() : std::vector<std::string>(),
                                           .interface = setup_.config.interface,
                                           .folder = job_folder()},
                                          die);
  if (!doorbells.ok()) return doorbells.status();
  doorbells_ = std::move(*doorbells);
  const ConnectionLimits limits = connection_limits(setup_.mpi.size());
  port_ = std::make_unique<net::DataPort>(loop_, data_options(setup_, credentials_, limits));
  bridge_ = std::make_unique<Bridge>(loop_, engine_, *doorbells_, *port_, setup_.mpi.size());
  control_ = std::make_unique<net::Control>(loop_, control_options(limits), *bridge_);
  return listen();
}

// Locks the endpoints first: one service serves each, and has its data directory.
Status Rank0::open_data_directory() {
  const Config& config = setup_.config;
  EndpointNote note;
  note.process = ProcessId::self();
  note.program = "rcbd";
  note.data_dir = config.data_dir.empty() ? data_directory_for(config.endpoint()) : config.data_dir;
  note.endpoint = config.endpoint();
  if (Status status = lock_endpoints(note); !status.ok()) return status;
  auto data = net::DataDirectory::open(note.data_dir, !config.data_dir.empty(), note);
  if (!data.ok()) return data.status();
  data_.emplace(std::move(*data));
  if (!config.empty || config.restarted) return {};
  const auto aside = scene::set_scenes_aside(*storage_, data_->path());
  if (aside.ok() && !aside->empty()) spdlog::info("the scenes of an earlier service are kept in {}", *aside);
  return aside.status();
}

Status Rank0::lock_endpoints(EndpointNote note) {
  const Config& config = setup_.config;
  if (!config.socket.empty())
    if (Status status = lock_endpoint("unix:" + config.socket, note); !status.ok()) return status;
  for (const std::string& where : config.listen)
    if (!where.ends_with(":0"))
      if (Status status = lock_endpoint(where, note); !status.ok()) return status;
  return {};
}

// Also removes the sockets left by a service that was killed.
Status Rank0::lock_endpoint(const std::string& endpoint, EndpointNote note) {
  note.endpoint = endpoint;
  auto lock = take_endpoint(note);
  if (lock.ok())
    endpoint_locks_.push_back(std::move(*lock));
  else if (!held_by_supervisor(endpoint_lock_path(endpoint)))
    return lock.status();
  if (endpoint.starts_with("unix:")) remove_dead_sockets(endpoint.substr(5));
  return {};
}

Status Rank0::open_credentials() {
  const Config& config = setup_.config;
  if (config.listen.empty() && !setup_.hosts.several) return {};
  const std::string_view prefix = config.trusted_network ? auth::kTrustedNetworkPrefix : std::string_view();
  auto token = config.restarted ? data_->kept_token(prefix) : data_->new_token(prefix);
  if (!token.ok()) return token.status();
  credentials_ = credentials_with(std::move(*token));
  return {};
}

net::ControlOptions Rank0::control_options(const ConnectionLimits& limits) const {
  net::ControlOptions options;
  options.version = RCB_VERSION;
  options.ranks = setup_.mpi.size();
  options.hosts = setup_.hosts.ranks;
  options.restarted = setup_.config.restarted;
  options.data_dir = data_->path();
  options.credentials = credentials_;
  options.bulk_bytes_max = setup_.service.bulk_bytes_max;
  options.sessions_max = limits.sessions;
  options.waiting_max = limits.waiting;
  options.files_over_tcp = !setup_.config.files_below.empty();
  // At once, since a rank that is stuck may keep the service from ending cleanly.
  options.keeping = {.keep_reports = setup_.config.keep_reports, .storage = storage_, .data_dir = data_->path()};
  options.told_to_end = [path = data_->path()] { (void)net::leave_end_marker(path); };
  return options;
}

Status Rank0::listen() {
  const Config& config = setup_.config;
  if (!config.socket.empty()) {
    if (Status status = control_->listen_unix(config.socket); !status.ok()) return status;
    endpoints_.push_back("unix:" + config.socket);
    spdlog::info("listening on unix:{}", config.socket);
  }
  for (const std::string& where : config.listen)
    if (Status status = listen_tcp(where); !status.ok()) return status;
  loop_.on_signals([this](int number) { control_->shut_down(fmt::format("signal {}", number)); });
  return {};
}

Status Rank0::listen_tcp(const std::string& where) {
  const auto bound = control_->listen_tcp(where);
  if (!bound.ok()) return bound.status();
  endpoints_.push_back(*bound);
  if (setup_.hosts.several && bound->starts_with("127.") && !where.starts_with("127."))
    return {Code::invalid_argument, fmt::format("{} is {} on this machine, which no other reaches", where, *bound),
            "give the machine's address on the network"};
  if (Status status = offer_token(where, *bound); !status.ok()) return status;
  spdlog::info("listening on {}, token in {}", *bound, join_path(data_->path(), kTokenFile));
  return {};
}

// Puts the token where clients on this machine look for it: they name the endpoint by the address, or as it was given.
Status Rank0::offer_token(const std::string& given, const std::string& bound) {
  std::set<std::string> directories{data_directory_for(bound)};
  if (!given.ends_with(":0")) directories.insert(data_directory_for(given));
  directories.erase(data_->path());
  for (const std::string& directory : directories) {
    auto offered = net::OfferedToken::offer(directory, credentials_.token);
    if (!offered.ok()) return offered.status();
    offered_.push_back(std::move(*offered));
  }
  return {};
}

void Rank0::open_direct_path() {
  DirectPath path{credentials_.token, {}};
  if (!setup_.config.gateway_only)
    for (const std::string& endpoint : endpoints_)
      path.places.push_back(endpoint.starts_with("unix:") ? endpoint : host_of(endpoint));
  share_direct_path(setup_.mpi, path);
  const auto addresses = server::open_direct_path(setup_.mpi, *port_, path.places, {});
  hub_ = std::make_unique<net::DataHub>(*doorbells_, *port_, setup_.mpi.size());
  doorbells_->on_peer_message([this](int rank, const wire::Json& message) {
    if (const auto orders = message.find("executed"); orders != message.end())
      bridge_->executed(rank, orders->get<std::uint64_t>());
    if (const auto memory = message.find("memory"); memory != message.end())
      control_->memory_reported(rank, memory->get<std::uint64_t>());
    if (message.contains("number")) control_->slice_reported(rank, net::read_report(message));
  });
  control_->set_silence_query([this] { return doorbells_->silent(); });
  for (std::size_t i = 0; i < path.places.size(); ++i)
    if (!addresses.by_place[i].empty()) control_->serve_data(*hub_, endpoints_[i], addresses.by_place[i]);
  control_->serve_this_machine(addresses.local);
  port_->start([this](const net::SliceReport& report) { control_->slice_reported(0, report); });
}

void Rank0::serve() {
  watch(loop_, engine_, setup_.config, [this] {
    doorbells_->tick();
    port_->tick();
    control_->tick();
  });
  loop_.start();
  const Status connected = doorbells_->wait_connected(kStartSeconds);
  if (!connected.ok()) die(connected.message());
  loop_.run([this] { control_->start(); });
  say_ready(endpoints_);
  spdlog::info("rcbd {} is up: {} ranks, pid {}{}", RCB_VERSION, setup_.mpi.size(), ::getpid(),
               setup_.config.restarted ? ", started again" : "");
  run_engine();
  finish();
}

void Rank0::run_engine() {
  const SteadyClock clock;
  service::Service service(setup_.mpi.comm(), clock, setup_.service);
  engine_.run(service);
}

void Rank0::finish() {
  control_->finish(kGoodbyeSeconds);
  loop_.run([this] { port_->finish(); });
  doorbells_->finish(kGoodbyeSeconds);
  loop_.stop();
  setup_.mpi.finish(kFinalizeSeconds);
  // A failure is harmless (a full disk, say): the exit code tells a clean end, too.
  const Status marked = net::leave_end_marker(data_->path());
  if (!marked.ok()) spdlog::warn("no end marker: {}", marked.message());
  spdlog::info("ended cleanly");
  end_in_order();
}

}  // namespace

int run_rank_0(const RankSetup& setup) {
  Rank0 rank(setup);
  const Status opened = rank.open();
  if (!opened.ok()) say_failure(opened);
  setup.mpi.share(opened.ok() ? rank.doorbell_address() : "");
  if (!opened.ok()) return 1;
  rank.open_direct_path();
  rank.serve();
  return 0;
}

}  // namespace rcb::server
