// EndpointFile: where a service is, written by whoever started it, for clients on any machine that sees the file
// (`file:PATH` in the place of an endpoint).
//
// Invariants
// 1. The file is whole or not there: it is written beside its place and renamed.
// 2. It holds no secret, only the path of the file with the token.
// 3. It is read only if it belongs to this user and nobody else can write it: it could name any service and any token.
#pragma once

#include <string>

#include "common/base/status.hpp"

namespace rcb::client {

struct EndpointFile {
  std::string endpoint;    // HOST:PORT or unix:PATH
  std::string host;        // where it was written
  std::string job;         // the batch job, else the supervisor's process
  std::string token_file;  // empty: the service has none
};

// Errors: unavailable (there is none), invalid_argument (it is something else), those of open_own_file().
Result<EndpointFile> read_endpoint_file(const std::string& path);
// Whether an endpoint file may be written here: there is none, or one of this user. Errors: as above.
Status check_endpoint_place(const std::string& path);
// Errors: io_error, those of check_endpoint_place().
Status write_endpoint_file(const std::string& path, const EndpointFile& file);
// Unless another service has written it meanwhile.
void remove_endpoint_file(const std::string& path, const EndpointFile& own);

}  // namespace rcb::client
