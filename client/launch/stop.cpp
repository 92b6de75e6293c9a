// Stops a service, in whatever state it is: it answers, it is silent, it waits to be restarted, or it was killed and
// has left files. Also finds out whether it is gone.
#include <algorithm>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <signal.h>
#include <unistd.h>

#include "client/launch/job/job_folder.hpp"
#include "client/launch/job/processes.hpp"
#include "client/launch/launch.hpp"
#include "client/launch/reach.hpp"
#include "client/lib/connect/endpoint.hpp"
#include "common/base/clock.hpp"
#include "common/files/endpoint_lock.hpp"
#include "common/files/socket_file.hpp"

namespace rcb::launch {
namespace {

constexpr double kForceSeconds = 30;
constexpr double kKillSeconds = 5;
constexpr double kLookSeconds = 0.05;
constexpr double kAskSeconds = 2;

// The known processes of a service on this machine: its supervisor, if it has one, first; then mpirun and rank 0.
class Running {
 public:
  Running(std::string endpoint, const ProcessId& rank0) : endpoint_(std::move(endpoint)) {
    const auto holder = endpoint_holder(endpoint_);
    if (holder && holder->process.exists() && process_info(holder->process.pid).name == kSupervisorName)
      add(holder->process);
    if (rank0.pid <= 1 || !process_info(rank0.pid).name.starts_with("rcbd")) return;
    const pid_t parent = process_info(rank0.pid).parent;
    const std::string name = process_info(parent).name;
    if (name == "mpirun" || name == "orterun" || name == "prterun") add(ProcessId::of(parent));
    add(rank0);
    rank0_known_ = true;
  }

  const std::string& endpoint() const { return endpoint_; }
  bool known() const { return !processes_.empty(); }
  void signal_first(int number) const {
    if (known()) processes_.front().signal(number);
  }
  void signal_all(int number) const {
    for (const Process& process : processes_) process.signal(number);
  }
  // True when all processes are gone, and the endpoint, too. Where rank 0 was known, whoever serves the endpoint
  // afterwards is another service.
  bool await_end(double seconds) const {
    const SteadyClock clock;
    const double deadline = clock.seconds() + seconds;
    for (const Process& process : processes_)
      while (!process.ended(kLookSeconds))
        if (clock.seconds() > deadline) return false;
    while (endpoint_is_served(deadline - clock.seconds())) {
      if (clock.seconds() > deadline) return false;
      usleep(static_cast<useconds_t>(1e6 * kLookSeconds));
    }
    return true;
  }
  std::vector<pid_t> left() const {
    std::vector<pid_t> pids;
    for (const Process& process : processes_)
      if (!process.ended(0)) pids.push_back(process.pid());
    return pids;
  }

 private:
  void add(const ProcessId& id) { processes_.emplace_back(id); }
  // Of a service elsewhere, whose processes can't be seen, only its answers tell.
  bool endpoint_is_served(double seconds) const {
    if (!known())
      return reach(endpoint_, "rcbctl down", std::clamp(seconds, kLookSeconds, kAskSeconds)).status().code() !=
             Code::unavailable;
    return !rank0_known_ && endpoint_.starts_with("unix:") && socket_state(endpoint_.substr(5)) == SocketState::live;
  }

  std::string endpoint_;
  std::vector<Process> processes_;
  bool rank0_known_ = false;
};

// Removes what killed services have left: job folders of any endpoint, and the sockets of this one. Returns the paths.
std::vector<std::string> remove_leftovers(const std::string& endpoint) {
  std::vector<std::string> removed = JobFolder::sweep("");
  if (!endpoint.starts_with("unix:")) return removed;
  const auto lock = take_endpoint({.process = ProcessId::self(), .program = "rcbctl down", .endpoint = endpoint});
  if (lock.ok())
    for (const std::string& path : remove_dead_sockets(endpoint.substr(5))) removed.push_back(path);
  return removed;
}

// Asks the supervisor to end its service; if that doesn't help, kills all processes.
Status end_by_force(const Running& running) {
  if (!running.known())
    return {Code::deadline_exceeded,
            fmt::format("the service at {} was told to end, and is still there", running.endpoint()),
            "wait, or end it on its own machine: rcbctl down"};
  running.signal_first(SIGTERM);
  if (running.await_end(kForceSeconds)) return {};
  running.signal_all(SIGKILL);
  const bool ended = running.await_end(kKillSeconds);
  (void)remove_leftovers(running.endpoint());
  if (ended) return {};
  const std::vector<pid_t> left = running.left();
  if (left.empty())
    return {Code::deadline_exceeded,
            fmt::format("the processes of the service at {} have ended, and another still listens there",
                        running.endpoint()),
            fmt::format("find it: ss -lxp | grep {}", running.endpoint().substr(running.endpoint().find(':') + 1))};
  return {Code::deadline_exceeded,
          fmt::format("the service at {} has not ended; processes: {}", running.endpoint(), fmt::join(left, " ")),
          "end them by hand (kill -9)"};
}

Result<Stopped> stop_answering(client::Client& client, double deadline_seconds) {
  const SteadyClock clock;
  const double end = clock.seconds() + deadline_seconds;
  const auto left = [&] { return std::max(0.0, end - clock.seconds()); };
  const Running running(client.endpoint(), rank0_of(client, left()));
  const Status told = client.call("shutdown", "{}", left()).status();
  // A service that ends may close the connection before its answer is read.
  if (!told && told.code() != Code::unavailable && told.code() != Code::deadline_exceeded) return told;
  running.signal_all(SIGCONT);  // stopped processes could not end
  if (!running.await_end(left()))
    if (Status ended = end_by_force(running); !ended) return ended;
  return Stopped{running.endpoint(), "stopped " + running.endpoint()};
}

// The supervisor lives, but the service doesn't answer: it hangs, or is about to be restarted.
Result<Stopped> stop_silent(const EndpointNote& holder) {
  const Running running(holder.endpoint, holder.program == "rcbd" ? holder.process : ProcessId{});
  if (!running.known())
    return Status(Code::unavailable,
                  fmt::format("{} is served by {}, which can't be reached", holder.endpoint, describe(holder)));
  running.signal_all(SIGCONT);
  if (Status ended = end_by_force(running); !ended) return ended;
  return Stopped{holder.endpoint,
                 fmt::format("stopped {}, which did not answer: ended {}", holder.endpoint, describe(holder))};
}

}  // namespace

Result<Stopped> stop_service(const std::string& given, double deadline_seconds) {
  auto client = reach(given, "rcbctl down");
  if (client.ok()) return stop_answering(*client, deadline_seconds);
  if (client.status().code() != Code::unavailable && client.status().code() != Code::deadline_exceeded)
    return client.status();
  const auto endpoints = client::endpoints_to_try(given);
  if (!endpoints.ok()) return endpoints.status();
  for (const client::Endpoint& endpoint : *endpoints)
    if (const auto holder = endpoint_holder(endpoint.text())) return stop_silent(*holder);
  for (const client::Endpoint& endpoint : *endpoints)
    if (const auto removed = remove_leftovers(endpoint.text()); !removed.empty())
      return Stopped{endpoint.text(),
                     fmt::format("no service ran any more at {}; removed what one that was killed has left: {}",
                                 endpoint.text(), fmt::join(removed, ", "))};
  return client.status();
}

Status explain_absence(const std::string& given, Status status) {
  if (status.code() != Code::unavailable && status.code() != Code::deadline_exceeded) return status;
  const auto endpoints = client::endpoints_to_try(given);
  if (!endpoints.ok()) return status;
  for (const client::Endpoint& endpoint : *endpoints)
    if (const auto holder = endpoint_holder(endpoint.text()))
      return {status.code(), fmt::format("{}; it is looked after by {}", status.message(), describe(*holder)),
              "wait for it, or stop it: rcbctl down"};
  return status;
}

}  // namespace rcb::launch
