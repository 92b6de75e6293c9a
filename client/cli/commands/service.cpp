// up, down: start and stop a service.
#include <fmt/format.h>

#include "client/cli/app.hpp"
#include "client/cli/print/output.hpp"
#include "client/lib/connect/endpoint.hpp"
#include "client/lib/connect/endpoint_file.hpp"
#include "common/files/own_files.hpp"
#include "common/files/paths.hpp"

namespace rcb::cli {
namespace {

constexpr std::int64_t kKeepReportsMax = std::int64_t{1} << 32U;  // as rcbd has it

struct UpOptions {
  int ranks = 0;
  launch::Hosts hosts;
  std::string publish;
  std::string data_dir;
  bool foreground = false;
  double deadline = 60;
  double answer_seconds = 30;
  // Options passed to rcbd at this start and at each restart.
  std::vector<std::string> files_below;
  bool empty = false;
  bool trusted_network = false;
  bool trusted_interconnect = false;
  std::string keep_reports;
  std::string log_level;
  std::string bulk_bytes;
};

// An option of rcbd that `up` takes too is added here and in add_up_options(). rcbd checks the values.
std::vector<std::string> service_arguments(const UpOptions& options, const client::Endpoint& endpoint) {
  std::vector<std::string> arguments;
  const auto add = [&arguments](const char* name, const std::string& value) {
    if (!value.empty()) arguments.insert(arguments.end(), {name, value});
  };
  for (const std::string& folder : options.files_below)
    add("--files-below", std::filesystem::absolute(folder).lexically_normal().string());
  // rcbd has another working directory, so paths are made absolute here.
  if (options.files_below.empty() && endpoint.is_unix)
    add("--local-files-below", std::filesystem::current_path().string());
  if (options.empty) arguments.emplace_back("--empty");
  if (options.trusted_network) arguments.emplace_back("--trusted-network");
  if (options.trusted_interconnect) arguments.emplace_back("--trusted-interconnect");
  add("--keep-reports", options.keep_reports);
  add("--log-level", options.log_level);
  add("--bulk-bytes", options.bulk_bytes);
  return arguments;
}

Status up(const UpOptions& options, const Context& context) {
  if (Status status = check_endpoint(context); !status) return status;
  std::error_code gone;
  if (const auto here = std::filesystem::current_path(gone); here.empty())
    return {Code::io_error, "the working directory is gone: " + gone.message(),
            "go to one that exists: below it clients of the Unix socket may use files"};
  launch::SuperviseOptions service;
  const auto endpoint = client::endpoint_to_serve(context.endpoint);
  if (!endpoint) return endpoint.status();
  service.endpoint = endpoint->text();
  service.hosts = options.hosts;
  if (!service.hosts.several()) {
    if (Status status = launch::check_job_is_here(); !status) return status;
    service.hosts = launch::hosts_of_job();
    service.hosts.interface = options.hosts.interface;
  }
  if (!service.hosts.file.empty()) service.hosts.file = std::filesystem::absolute(service.hosts.file).string();
  service.ranks = options.ranks > 0 ? options.ranks : launch::default_ranks();
  if (service.hosts.several() || service.hosts.job_tasks > 0) {
    const auto slots = service.hosts.slots();
    if (!slots) return slots.status();
    if (options.ranks == 0) service.ranks = *slots;
  }
  if (!options.publish.empty()) {
    service.publish = std::filesystem::absolute(options.publish).lexically_normal().string();
    if (Status status = client::check_endpoint_place(service.publish); !status) return status;
  }
  service.ready_seconds = options.deadline;
  service.silence_seconds = options.answer_seconds;
  service.ask_seconds = std::min(service.ask_seconds, options.answer_seconds / 3);
  service.service_arguments = service_arguments(options, *endpoint);
  auto running = launch::reach(service.endpoint, "rcbctl up");
  if (!running && running.status().code() == Code::not_authorised) {
    if (!endpoint->is_unix) return running.status();
    return {Code::not_authorised, running.status().message(),
            "choose a folder of yours for the socket, with --endpoint"};
  }
  if (running)
    return {Code::already_exists, "a service already answers at " + service.endpoint,
            "use it, or stop it first: rcbctl down"};
  if (options.data_dir.empty()) {
    service.data_dir = client::data_directory(*endpoint);
    if (Status status = make_private_directory(service.data_dir); !status)
      return naming(endpoint->is_unix ? "--data-dir" : "XDG_STATE_HOME", status);
  } else {
    service.data_dir = std::filesystem::absolute(options.data_dir).lexically_normal().string();
    if (Status status = make_own_directory(service.data_dir); !status) return status;
  }
  const std::string log = launch::log_path(service.data_dir);
  if (options.foreground) {
    note(fmt::format("{} ranks on {}; log: {}", service.ranks, service.endpoint, log));
    return launch::supervise(service);
  }
  {
    Progress progress(fmt::format("starting {} ranks on {}", service.ranks, service.endpoint));
    Status status = launch::start_detached(service, [&progress](double seconds) { progress.seconds(seconds); });
    if (!status) return status;
  }
  return show(context,
              {{"endpoint", service.endpoint}, {"ranks", service.ranks}, {"data_dir", service.data_dir}, {"log", log}},
              [&] {
                Facts facts;
                facts.add("endpoint", service.endpoint);
                facts.add("ranks", std::to_string(service.ranks));
                facts.add("log", log);
                facts.print();
              });
}

Status down(double deadline, const Context& context) {
  if (Status status = check_endpoint(context); !status) return status;
  Progress progress("down");
  progress.stage("waiting for the service's end");
  const auto stopped = launch::stop_service(context.endpoint, deadline);
  progress.clear();
  if (!stopped) return stopped.status();
  return show(context, {{"endpoint", stopped->endpoint}, {"stopped", true}, {"said", stopped->said}},
              [&] { print_line(stopped->said); });
}

void add_up_options(CLI::App& command, UpOptions& options) {
  add_value(command, "-n,--ranks", options.ranks, kind::rank_count(),
            "MPI ranks (default: in a Slurm or PBS job one per task, with --hosts or --hostfile the sum of what they "
            "say, else one per core, at most 8)");
  CLI::Option* list = add_value(
      command, "--hosts", options.hosts.list, kind::text("A:4,B:4"),
      "machines and the ranks on each, this one first (default: those of the Slurm or PBS job, else this one)");
  add_value(command, "--hostfile", options.hosts.file, kind::text("FILE"), "machines, in a hostfile of Open MPI")
      ->excludes(list);
  add_value(command, "--interface", options.hosts.interface, kind::text("NAME"),
            "network between the machines: an interface, or an IPv4 network such as 10.0.0.0/8 (default: any)");
  add_value(command, "--publish", options.publish, kind::text("FILE"),
            "write where the service is to FILE once it answers; clients take file:FILE for an endpoint");
  add_value(command, "--data-dir", options.data_dir, kind::text("DIR"),
            "for the log, the token, and what lasts of the scenes (default: one per endpoint)");
  command.add_flag("--empty", options.empty,
                   "begin without the scenes of the service that was there before; they are kept aside in the data "
                   "directory");
  add_value(command, "--deadline", options.deadline, kind::positive_number("SECONDS"),
            "how long to wait for its first answer")
      ->capture_default_str();
  add_value(command, "--answer-seconds", options.answer_seconds, kind::number_between("SECONDS", 1, 86400),
            "a service that has not answered for so long is killed and started again")
      ->capture_default_str();
  command.add_flag("--foreground", options.foreground,
                   "stay and supervise it here until SIGTERM, SIGINT or SIGHUP, as a systemd unit wants it");
  add_value(command, "--files-below", options.files_below, kind::text("DIR"),
            "a folder below which commands may read and write files; may be given more than once (default: on a Unix "
            "socket the working directory, over TCP none)");
  command.add_flag("--trusted-network", options.trusted_network,
                   "you trust every network between machines: nothing is encrypted (default: clients' connections from "
                   "other machines are encrypted by TLS 1.3)");
  command.add_flag("--trusted-interconnect", options.trusted_interconnect,
                   "you trust the network between the service's machines, on which MPI's messages are not encrypted; "
                   "ranks on several machines require this or --trusted-network");
  add_value(command, "--keep-reports", options.keep_reports, kind::whole_number("K", 1, kKeepReportsMax),
            "step reports kept in memory, of all scenes together; older ones go to files (default: 100000)");
  add_value(command, "--log-level", options.log_level,
            kind::one_of("LEVEL", {"trace", "debug", "info", "warn", "error", "off"}),
            "how much is logged: trace, debug, info, warn, error or off");
  add_value(command, "--bulk-bytes", options.bulk_bytes, kind::memory_size(),
            "most bytes of arrays that all pushes together may hold, such as 4gb");
}

}  // namespace

void add_service_commands(CLI::App& app, Context& context) {
  auto [starts, options] = add_command(
      app, context,
      {"up", "Starts a service on the endpoint and waits until it answers",
       "  rcbctl up -n 8\n  rcbctl up --endpoint unix:$HOME/run/rcbd.sock --data-dir $HOME/run/rcbd\n"
       "  rcbctl up --hosts a:4,b:4 --endpoint a:7470 --trusted-interconnect --data-dir ~/rcbd --publish ~/rcbd.where",
       kServiceGroup},
      up);
  add_up_options(starts, options);

  auto deadline = std::make_shared<double>(30);
  CLI::App* command = add_command(app, context,
                                  {"down", "Stops the service cleanly and waits until it is gone",
                                   "  rcbctl down\n  rcbctl down --endpoint unix:$HOME/run/rcbd.sock", kServiceGroup},
                                  [deadline, &context] { return down(*deadline, context); });
  add_value(*command, "--deadline", *deadline, kind::positive_number("SECONDS"),
            "how long to wait before it is ended by force")
      ->capture_default_str();
}

}  // namespace rcb::cli
