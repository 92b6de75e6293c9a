#include "server/program/direct_path.hpp"

#include <algorithm>
#include <sstream>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <spdlog/spdlog.h>

#include "common/auth/proof.hpp"
#include "common/base/host_port.hpp"
#include "common/files/own_files.hpp"
#include "common/files/paths.hpp"
#include "common/files/socket_file.hpp"
#include "common/tls/identity.hpp"
#include "server/net/control/control.hpp"

namespace rcb::server {
namespace {

// Where this rank listens for the clients of an endpoint: at its place, or, if that is on another machine's network
// interface, at this machine's own. Errors: unsupported, if the endpoint's clients can't reach this machine.
Result<std::string> listen_at(net::DataPort& port, const std::string& place, int rank, const std::string& elsewhere) {
  const bool is_unix = place.starts_with("unix:");
  if (!elsewhere.empty() && (place.starts_with("127.") || place == "[::1]"))  // its clients may come through a tunnel
    return Status(Code::unsupported,
                  fmt::format("rank {} is on another machine, and clients here push by way of rank 0", rank));
  if (!is_unix || !elsewhere.empty())
    return port.listen_tcp(elsewhere.empty() ? place + ":0" : join_host_port(elsewhere, 0));
  const std::string address = fmt::format("{}.{}", place, rank);
  if (Status status = port.listen_unix(address.substr(5)); !status.ok()) return status;
  return address;
}

// Where this rank listens for clients on its own machine, if no endpoint is a Unix socket there. Only this user can
// connect to a socket, even in /tmp, and nobody else can guess or take its name.
std::string listen_for_this_machine(net::DataPort& port, int rank) {
  const std::string prefix = "rcbd-";
  const std::string name = fmt::format("/{}{}.{}", prefix, auth::random_hex(8), rank);
  const std::string shared = "/tmp";
  const std::string job = job_folder();
  if (job != shared && is_own_directory(job) && port.listen_unix(job + name).ok()) return "unix:" + job + name;
  remove_old_dead_sockets(shared, prefix);  // of ranks that were killed where no launcher is that would remove them
  const Status status = port.listen_unix(shared + name);
  if (status.ok()) return "unix:" + shared + name;
  spdlog::warn("clients on this machine reach rank {} over TCP alone: {}", rank, status.message());
  return "";
}

}  // namespace

DirectPath share_direct_path(ranks::MpiSession& mpi, const DirectPath& of_rank_0) {
  std::istringstream lines(mpi.share(fmt::format("{}\n{}", of_rank_0.token, fmt::join(of_rank_0.places, "\n"))));
  DirectPath path;
  std::getline(lines, path.token);
  for (std::string line; std::getline(lines, line);) path.places.push_back(line);
  return path;
}

DataAddresses open_direct_path(ranks::MpiSession& mpi, net::DataPort& port, const std::vector<std::string>& places,
                               const std::string& elsewhere) {
  std::string text;
  std::string local;
  for (const std::string& place : places) {
    const Result<std::string> address = listen_at(port, place, mpi.rank(), elsewhere);
    if (!address.ok()) spdlog::warn("no direct path at {}: {}", place, address.status().message());
    if (address.ok() && address->starts_with("unix:")) local = *address;
    text += (address.ok() ? *address : "") + "\n";
  }
  if (local.empty() && !places.empty()) local = listen_for_this_machine(port, mpi.rank());
  text += local + "\n" + machine_key() + "\n";
  DataAddresses found;
  found.by_place.resize(places.size());
  for (const std::string& of_rank : mpi.gather(text)) {
    std::istringstream lines(of_rank);
    for (auto& addresses : found.by_place) std::getline(lines, addresses.emplace_back());
    net::LocalAddress& own = found.local.emplace_back();
    std::getline(lines, own.address);
    std::getline(lines, own.machine);
  }
  for (auto& addresses : found.by_place)
    if (std::find(addresses.begin(), addresses.end(), "") != addresses.end()) addresses.clear();
  return found;
}

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

net::DataOptions data_options(const RankSetup& setup, net::Credentials credentials, const ConnectionLimits& limits) {
  net::DataOptions options;
  options.connections_max = limits.sessions;
  options.waiting_max = limits.waiting;
  options.rank = setup.mpi.rank();
  options.credentials = std::move(credentials);
  options.bulk_bytes_max = setup.service.bulk_bytes_max;
  options.spare = setup.service.spare;
  return options;
}

std::uint64_t bulk_bytes(const Config& config) {
  return config.bulk_bytes != 0 ? config.bulk_bytes : net::bulk_bytes_default();
}

}  // namespace rcb::server
