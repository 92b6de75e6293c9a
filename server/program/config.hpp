// Config: rcbd's command line, environment (RCBD_*) and configuration file, in this order of precedence.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace rcb::server {

struct Config {
  std::vector<std::string> listen;    // HOST:PORT
  std::string socket;                 // if neither is given: the default socket
  bool trusted_network = false;       // nothing is encrypted between machines
  bool trusted_interconnect = false;  // nothing is encrypted between ranks on different machines, clients' traffic is
  std::string interface;              // between ranks on different machines; empty: any that reaches rank 0
  std::string data_dir;               // empty: the endpoint's default
  // Folders below which clients may have the service read and write files.
  std::vector<std::string> files_below;        // for clients of every listener
  std::vector<std::string> local_files_below;  // for clients of the Unix socket alone; used if files_below is empty
  std::string log_level = "info";
  std::uint64_t bulk_bytes = 0;  // 0: half of the memory
  double silence_seconds = 15;
  double stall_seconds = 120;
  bool empty = false;  // begins without the scenes of an earlier service, which are set aside
  std::size_t keep_reports = 100'000;  // step reports in memory, all scenes together
  bool restarted = false;
  std::string no_skip;        // NoSkip::parse
  bool gateway_only = false;  // ranks don't open listeners of their own

  // The name that clients use: the socket, else the first TCP address.
  std::string endpoint() const;
};

// The options, or what to print and the exit code if the service isn't to run (--help, --version, an error).
struct ParsedConfig {
  Config config;
  bool run = false;
  int exit_code = 0;
  std::string out;    // for stdout
  std::string error;  // for stderr
};

ParsedConfig parse_config(int argc, const char* const* argv);

}  // namespace rcb::server
