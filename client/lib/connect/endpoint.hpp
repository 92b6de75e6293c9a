// The endpoint of a service as text, the endpoints that a client tries, and the files that belong to an endpoint. Used
// by the client library, rcbctl and the launcher.
//
// Invariants
// 1. text() is canonical: two texts that name the same socket give the same endpoint, hence the same data directory.
// 2. A token found in a file is proved only to a service on this machine, or to the one that an endpoint file names.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.hpp"

namespace rcb::client {

inline constexpr std::uint16_t kDefaultPort = 7470;
inline constexpr std::string_view kFilePrefix = "file:";  // of an endpoint file (endpoint_file.hpp)

struct Endpoint {
  bool is_unix = true;
  std::string path;  // absolute, normalised
  std::string host;  // TCP: name or address, IPv6 without brackets
  std::uint16_t port = 0;
  // Of one that was found in a file:
  std::string published;   // "the service that wrote PATH (job J on host H)"
  std::string token_file;  // its token, if it has one

  // "unix:PATH", "HOST:PORT" or "[IPv6]:PORT".
  std::string text() const;
  friend bool operator==(const Endpoint&, const Endpoint&) = default;
};

// unix:PATH (also a bare path with a slash) or HOST:PORT; a relative path starts at the working directory. Errors:
// invalid_argument.
Result<Endpoint> parse_endpoint(std::string_view text);

// What a client tries, in this order: `given`, else RCBD_ENDPOINT, else the default socket, then 127.0.0.1:7470. Of
// file:PATH what the file says now (endpoint_file.hpp). Errors: invalid_argument; those of read_endpoint_file().
Result<std::vector<Endpoint>> endpoints_to_try(const std::string& given);
// Where to start a service: `given`, else RCBD_ENDPOINT, else the default socket.
Result<Endpoint> endpoint_to_serve(const std::string& given);

// The default data directory of the service at this endpoint, and its token there.
std::string data_directory(const Endpoint& endpoint);
std::string token_path(const Endpoint& endpoint);

// The tokens a client may try there, the likeliest first: `given`, else RCBD_TOKEN (the token itself), else the file
// RCBD_TOKEN_FILE, else what an endpoint file names, else, if the service is on this machine, the files in the data
// directories of this endpoint and of the other local names of its port. Errors: invalid_argument, if RCBD_TOKEN_FILE
// can't be read; not_authorised, if what an endpoint file names can't be read on this machine, which isn't the
// service's.
Result<std::vector<std::string>> tokens_for(const Endpoint& endpoint, const std::string& given, bool this_machine);

}  // namespace rcb::client
