#include "server/program/hosts.hpp"

#include <cstdint>
#include <cstdlib>

#include <fmt/format.h>
#include <unistd.h>

#include "common/files/paths.hpp"
#include "common/wire/message.hpp"
#include "server/net/peers/host.hpp"

namespace rcb::server {

Hosts find_hosts(ranks::MpiSession& mpi) {
  Hosts hosts;
  std::string key_of_root;
  for (const std::string& text :
       mpi.gather(wire::Json{{"name", host_name()}, {"key", machine_key()}, {"pid", ::getpid()}}.dump())) {
    const wire::Json one = wire::Json::parse(text);
    const std::string key = one.at("key").get<std::string>();
    if (hosts.ranks.empty()) key_of_root = key;
    hosts.ranks.push_back({one.at("name").get<std::string>(), one.at("pid").get<std::int64_t>()});
    hosts.with_root.push_back(key == key_of_root);
    hosts.several = hosts.several || key != key_of_root;
  }
  return hosts;
}

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

}  // namespace rcb::server
