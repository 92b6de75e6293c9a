// Which ranks are on which machine, and the addresses by which machines reach each other.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "common/base/status.hpp"

namespace rcb::net {

// A listener for clients on the machine where it is.
struct LocalAddress {
  std::string address;  // "unix:PATH"; empty: there is none
  std::string machine;  // machine_key()
};

// Where a rank runs.
struct RankHost {
  std::string host;
  std::int64_t pid = 0;
};

// The addresses of this machine at which others may reach it, without ports: none of the loopback interface, IPv4
// first. `interface` is the name of one (eth0), an address, or a network (10.0.0.0/8); empty: all. Errors:
// invalid_argument (none is left), io_error.
Result<std::vector<std::string>> addresses_on(const std::string& interface);

}  // namespace rcb::net
