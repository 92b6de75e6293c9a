// Where a service is: its endpoint in words, the endpoints that a client tries, and the files beside it. The client
// library, rcbctl and the launcher all ask here.
//
// Invariants
// 1. text() is canonical: two texts that mean the same socket give the same endpoint, hence the same data directory.
// 2. A token found in a file is offered to a service on this machine only.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.hpp"

namespace rcb::client {

inline constexpr std::uint16_t kDefaultPort = 7470;

struct Endpoint {
  bool is_unix = true;
  std::string path;  // unix: absolute, normal
  std::string host;  // TCP: name or address, IPv6 without brackets
  std::uint16_t port = 0;

  // "unix:PATH", "HOST:PORT" or "[IPv6]:PORT".
  std::string text() const;
  friend bool operator==(const Endpoint&, const Endpoint&) = default;
};

// unix:PATH (a bare path with a slash counts too) or HOST:PORT; a relative path is taken from the working directory.
// Errors: invalid_argument.
Result<Endpoint> parse_endpoint(std::string_view text);

// What a client tries, in order: `given`, else RCBD_ENDPOINT, else the default socket, then 127.0.0.1:7470.
Result<std::vector<Endpoint>> endpoints_to_try(const std::string& given);
// Where a service is to be started: `given`, else RCBD_ENDPOINT, else the default socket.
Result<Endpoint> endpoint_to_serve(const std::string& given);

// The default data directory of the service at that endpoint, and the files in it.
std::string data_directory(const Endpoint& endpoint);
std::string log_path(const Endpoint& endpoint);
std::string token_path(const Endpoint& endpoint);
std::string marker_path(const Endpoint& endpoint);  // left by a service that ended as told

// The tokens a client may offer there, the likeliest first: `given`, else RCBD_TOKEN (the token itself), else the
// file RCBD_TOKEN_FILE, else, if the service is on this machine, the files in the data directories of this endpoint
// and of the other local names of its port. Errors: invalid_argument, where RCBD_TOKEN_FILE can't be read.
Result<std::vector<std::string>> tokens_for(const Endpoint& endpoint, const std::string& given, bool this_machine);

}  // namespace rcb::client
