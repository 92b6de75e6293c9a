#include "server/program/config.hpp"

#include <cstdlib>
#include <sstream>

#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include "common/base/byte_size.hpp"
#include "common/base/cpu.hpp"
#include "common/base/text.hpp"
#include "common/files/paths.hpp"
#include "server/service/scene/no_skip.hpp"

namespace rcb::server {

std::string Config::endpoint() const { return socket.empty() ? listen.front() : "unix:" + socket; }

namespace {

void add_file_options(CLI::App& app, Config& config) {
  app.add_option("--files-below", config.files_below,
                 "folder below which commands may have the service read and write files (load, write_parts). May be "
                 "given more than once [default: for clients of the Unix socket the working directory, for those over "
                 "TCP none; RCBD_FILES_BELOW: folders with colons between]")
      ->type_name("DIR");
  app.add_option("--local-files-below", config.local_files_below,
                 "the same for clients of the Unix socket alone, instead of the working directory")
      ->type_name("DIR");
}

// Completes the folders for clients' files once all options have been read.
void complete_file_options(Config& config) {
  const char* folders = std::getenv("RCBD_FILES_BELOW");
  if (config.files_below.empty() && folders != nullptr) {
    std::istringstream list(folders);
    for (std::string folder; std::getline(list, folder, ':');)
      if (!folder.empty()) config.files_below.push_back(folder);
  }
  if (config.files_below.empty() && config.local_files_below.empty() && !config.socket.empty())
    config.local_files_below = {"."};
}

std::string check_bytes(std::string& text) {
  const auto bytes = read_memory_size(text);
  if (bytes.ok()) text = std::to_string(*bytes);
  return bytes.status().message();
}

void add_options(CLI::App& app, Config& config) {
  app.set_version_flag("--version", "rcbd " RCB_VERSION);
  app.set_config("--config", "", "configuration file: the options below without dashes, as name = value")
      ->envname("RCBD_CONFIG");
  app.allow_config_extras(CLI::config_extras_mode::error);
  app.add_option("--socket", config.socket,
                 "Unix socket to listen on [default without --listen: " + default_socket_path() + "]")
      ->envname("RCBD_SOCKET")
      ->type_name("PATH");
  app.add_option(
         "--listen", config.listen,
         "TCP address to listen on, HOST:PORT; clients must know the token in the data directory, and TLS 1.3 is "
         "spoken except at loopback addresses. May be given more than once; port 0 takes a free one")
      ->envname("RCBD_LISTEN")
      ->type_name("HOST:PORT");
  app.add_flag("--trusted-network", config.trusted_network,
               "you trust every network between machines: nothing is encrypted. Without this, clients' connections "
               "from other machines are encrypted by TLS 1.3")
      ->envname("RCBD_TRUSTED_NETWORK");
  app.add_flag(
         "--trusted-interconnect", config.trusted_interconnect,
         "you trust the network between the service's machines, on which MPI's messages are not encrypted; ranks on "
         "several machines require this or --trusted-network")
      ->envname("RCBD_TRUSTED_INTERCONNECT");
  app.add_option(
         "--interface", config.interface,
         "the network between ranks on different machines: an interface, or a network such as 10.0.0.0/8 [default: any "
         "that reaches rank 0]")
      ->envname("RCBD_INTERFACE")
      ->type_name("NAME");
  app.add_option(
         "--data-dir", config.data_dir,
         "directory for lock, token, what lasts of the scenes and the note that it was told to end [default: one for "
         "each endpoint, below $XDG_STATE_HOME/rcbd, else ~/.local/state/rcbd]")
      ->envname("RCBD_DATA_DIR")
      ->type_name("DIR");
  add_file_options(app, config);
  app.add_option("--log-level", config.log_level, "how much is logged to standard error")
      ->envname("RCBD_LOG_LEVEL")
      ->check(CLI::IsMember({"trace", "debug", "info", "warn", "error", "off"}))
      ->capture_default_str();
  app.add_option("--bulk-bytes", config.bulk_bytes,
                 "most bytes of arrays that all pushes together may hold in memory before they are taken over; units "
                 "such as 4gb are understood [default: half of the memory]")
      ->envname("RCBD_BULK_BYTES")
      ->transform(CLI::Validator(check_bytes, ""));
  app.add_option("--silence-seconds", config.silence_seconds,
                 "a rank that gives no sign of life for so long counts as dead; the service then ends")
      ->envname("RCBD_SILENCE_SECONDS")
      ->check(CLI::Range(4.0, 3600.0))
      ->capture_default_str();
  app.add_option("--stall-seconds", config.stall_seconds,
                 "a command that is so far past its deadline ends the service (the launcher starts it again)")
      ->envname("RCBD_STALL_SECONDS")
      ->check(CLI::Range(1.0, 86400.0))
      ->capture_default_str();
  app.add_flag(
         "--empty", config.empty,
         "begins without the scenes that an earlier service has left in the data directory; they are set aside there")
      ->envname("RCBD_EMPTY");
  app.add_option("--keep-reports", config.keep_reports,
                 "step reports kept in memory, all scenes together; older ones go to files in the data directory")
      ->envname("RCBD_KEEP_REPORTS")
      ->check(CLI::Range(std::size_t{1}, std::size_t{1} << 32U))
      ->capture_default_str();
  app.add_flag(
         "--gateway-only", config.gateway_only,
         "take pushes at the endpoint alone; else every rank listens for its own slices, at SOCKET.RANK or on a TCP "
         "port of its own")
      ->envname("RCBD_GATEWAY_ONLY");
  app.add_option("--no-skip", config.no_skip,
                 "for measurement only: work that is done although no step needs it, its results dropped: exchange, "
                 "search, warm, with commas between")
      ->envname("RCBD_NO_SKIP")
      ->check(CLI::Validator(
          [](const std::string& names) {
            const auto parsed = service::NoSkip::parse(names);
            return parsed.ok() ? std::string() : parsed.status().message() + "; " + parsed.status().hint();
          },
          "LIST"));
  app.add_flag("--restarted", config.restarted, "says in the status that a service before this one has died")
      ->envname("RCBD_RESTARTED");
}

ParsedConfig refuse(const std::string& message) {
  ParsedConfig refused;
  refused.exit_code = 2;
  refused.error = fmt::format("rcbd: {}\n  rcbd --help lists the options, and the variable of each\n",
                              escape_controls(message, "\n"));
  return refused;
}

}  // namespace

ParsedConfig parse_config(int argc, const char* const* argv) {
  ParsedConfig parsed;
  CLI::App app("rcbd, a partitioning service for particle codes", "rcbd");
  app.footer(
      "Start it with mpirun, one process a rank: mpirun --bind-to none --oversubscribe -n 8 rcbd\n"
      "'rcbctl up' does this and looks after it. Flags win over the environment, the environment over the file.");
  add_options(app, parsed.config);
  try {
    app.parse(argc, argv);
  } catch (const CLI::Success& asked) {
    std::ostringstream out;
    app.exit(asked, out, out);
    parsed.out = out.str();
    return parsed;
  } catch (const CLI::ConfigError& fault) {
    constexpr std::string_view kBefore = "INI was not able to parse ";
    constexpr std::size_t kNameMax = 64;
    const std::string_view text = fault.what();
    if (!text.starts_with(kBefore)) return refuse(fmt::format("the configuration file: {}", text));
    const std::string_view name = text.substr(kBefore.size(), kNameMax);
    return refuse(fmt::format("the configuration file has '{}', which is no option", name.substr(0, name.find(".++"))));
  } catch (const CLI::ParseError& fault) {
    return refuse(fault.what());
  }
  if (!cpu_is_known()) return refuse(kUnknownCpu);
  if (parsed.config.socket.empty() && parsed.config.listen.empty()) parsed.config.socket = default_socket_path();
  complete_file_options(parsed.config);
  parsed.run = true;
  return parsed;
}

}  // namespace rcb::server
