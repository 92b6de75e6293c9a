// The direct path: every rank's own listeners, at which clients push to the rank itself.
#pragma once

#include <string>
#include <vector>

#include "server/net/data/data_port.hpp"
#include "server/net/peers/doorbell.hpp"
#include "server/program/config.hpp"
#include "server/program/job.hpp"
#include "server/program/rank.hpp"
#include "server/ranks/mpi_session.hpp"

namespace rcb::server {

// Rank 0's word on it.
struct DirectPath {
  std::string token;                // which clients prove; empty if none is needed
  std::vector<std::string> places;  // "unix:PATH" or "HOST", one of each endpoint; none if all push by way of rank 0
};
// Collective. Returns rank 0's on every rank.
DirectPath share_direct_path(ranks::MpiSession& mpi, const DirectPath& of_rank_0);

struct DataAddresses {
  // By place, then by rank; none for a place where some rank couldn't listen.
  std::vector<std::vector<std::string>> by_place;
  // By rank: for clients on its own machine, whatever their endpoint.
  std::vector<net::LocalAddress> local;
};
// Collective. Every rank opens its listeners at the places, and a Unix socket; all ranks learn their addresses.
// elsewhere: the address of this machine, if it isn't rank 0's.
DataAddresses open_direct_path(ranks::MpiSession& mpi, net::DataPort& port, const std::vector<std::string>& places,
                               const std::string& elsewhere);

// With a certificate of this process, which the token's proofs are bound to, if there is a token to be proved.
net::Credentials credentials_with(std::string token);

// For the listeners of this rank.
net::DataOptions data_options(const RankSetup& setup, net::Credentials credentials, const ConnectionLimits& limits);

// The limit on the bytes of all pushes together; the same for every rank's listeners.
std::uint64_t bulk_bytes(const Config& config);

}  // namespace rcb::server
