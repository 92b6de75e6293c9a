// Which machines the ranks run on, and whether the service may.
#pragma once

#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "server/net/peers/host.hpp"
#include "server/program/config.hpp"
#include "server/ranks/mpi_session.hpp"

namespace rcb::server {

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
Hosts find_hosts(ranks::MpiSession& mpi);

// Rank 0. Errors: invalid_argument where rank 0 isn't on the machine whose launcher waits for it, and where ranks are
// on several machines of a network that nobody calls trusted: MPI's messages, the token among them, aren't encrypted.
Status check_hosts(const Hosts& hosts, const Config& config);

}  // namespace rcb::server
