#include "client/launch/supervisor.hpp"

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <optional>

#include <fmt/format.h>
#include <sys/prctl.h>
#include <unistd.h>

#include "client/launch/events.hpp"
#include "client/launch/job/environment.hpp"
#include "client/launch/job/job.hpp"
#include "client/launch/probe.hpp"
#include "client/launch/reach.hpp"
#include "client/launch/service_log.hpp"
#include "client/launch/silence_watch.hpp"
#include "client/lib/connect/endpoint_file.hpp"
#include "common/base/backoff.hpp"
#include "common/base/clock.hpp"
#include "common/files/endpoint_lock.hpp"
#include "common/files/own_files.hpp"
#include "common/files/paths.hpp"
#include "common/files/socket_file.hpp"

namespace rcb::launch {
namespace {

constexpr double kProbeSeconds = 0.05;
constexpr double kProbeDeadlineSeconds = 1;
constexpr double kAskSecondsLeast = 0.5;
constexpr double kAskSecondsMost = 5;
constexpr double kStopSeconds = 20;
constexpr double kUntoldSeconds = 5;  // for a job that couldn't be told to end
constexpr double kPauseJitter = 0.25;

class Supervisor {
 public:
  explicit Supervisor(const SuperviseOptions& options)
      : options_(options),
        log_(launch::log_path(options.data_dir)),
        marker_(join_path(options.data_dir, kCleanShutdownFile)),
        backoff_({options.pause_first_seconds, options.pause_most_seconds, kPauseJitter},
                 mix64(static_cast<std::uint64_t>(getpid()) ^ ProcessId::self().start << 32U)),
        silence_(options.ask_seconds, options.silence_seconds) {}

  Status run();

 private:
  enum class Outcome { running, ended, stopped, died, displaced };

  Status open();
  Status run_job();
  Status serve(Job& job);
  Status await_first_answer(Job& job);
  Status publish();
  Status keep(Job& job);
  template <typename Work>
  std::optional<Outcome> go_on_after_faults(const Work& work);
  Outcome watch(Job& job, std::string& why);
  std::string where(Job& job) const;
  bool is_silent(Job& job);
  Answer ask_service(Job& job, double deadline_seconds);
  std::string log_hint(const char* name) const;
  Outcome start_again(Job& job, std::string why);
  bool pause(double seconds);
  Status start(Job& job, bool restarted);
  void stop(Job& job);
  Status keep_place();
  bool is_displaced(const Status& status) const { return status.code() == Code::busy && !endpoint_lock_->in_place(); }
  Events::Event wait(double seconds) { return events_.wait(seconds, keep_output_); }
  void drain() { events_.drain(keep_output_); }
  // Adds what the job has said last.
  std::string with_tail(const std::string& text);
  std::string start_hint(const std::string& told) const;
  void tell_state(double start_at_unix);
  void notify(const Status& status);

  SuperviseOptions options_;
  ServiceLog log_;
  std::string marker_;
  SteadyClock clock_;
  Backoff backoff_;
  SilenceWatch silence_;
  EndpointNote note_;
  client::EndpointFile published_;
  std::optional<LockFile> endpoint_lock_;
  std::optional<LockFile> data_lock_;
  Events events_;
  const Events::OnOutput keep_output_ = [this](std::string_view bytes) { log_.add(bytes); };
  double started_ = 0;
  std::string last_complaint_;
  std::string last_fault_;
  std::string last_unasked_;  // why the service couldn't be asked, while it can't be
};

Status Supervisor::open() {
  note_ = {.process = ProcessId::self(),
           .program = "rcbctl up",
           .endpoint = options_.endpoint,
           .data_dir = options_.data_dir};
  auto endpoint = take_endpoint(note_);
  if (!endpoint.ok()) return endpoint.status();
  endpoint_lock_.emplace(std::move(*endpoint));
  if (Status made = make_own_directory(options_.data_dir); !made.ok()) return made;
  auto data = take_data_directory(note_);
  if (!data.ok()) return data.status();
  data_lock_.emplace(std::move(*data));
  if (Status opened = log_.open(); !opened.ok()) return opened;
  prctl(PR_SET_NAME, kSupervisorName.data());
  if (prctl(PR_SET_CHILD_SUBREAPER, 1) != 0)
    return {Code::internal, fmt::format("child subreaper: {}", std::strerror(errno))};
  return events_.open(options_.lifeline_fd);
}

Status Supervisor::run() {
  Status status;
  try {
    status = open();
    if (status) return run_job();
  } catch (const std::exception& fault) {
    status = {Code::internal, fmt::format("the launcher has failed: {}", fault.what()),
              "look at this shell's limits (ulimit -a): memory, open files"};
    log_.note(status.message());
  }
  notify(status);
  return status;
}

Status Supervisor::run_job() {
  for (const std::string& path : JobFolder::sweep(options_.data_dir))
    log_.note("removed what a killed service has left: " + path);
  Job job({.endpoint = options_.endpoint,
           .data_dir = options_.data_dir,
           .ranks = options_.ranks,
           .hosts = options_.hosts,
           .service_arguments = options_.service_arguments},
          options_.data_dir, events_.output_fd());
  const Status status = serve(job);
  job.kill();
  drain();
  if (options_.endpoint.starts_with("unix:") && endpoint_lock_->in_place())
    remove_dead_sockets(options_.endpoint.substr(5));
  log_.note(status ? "the service has ended" : "given up: " + status.message());
  return status;
}

Status Supervisor::serve(Job& job) {
  Status status = start(job, false);
  if (status) status = await_first_answer(job);
  if (status) {
    status = publish();
    if (!status) stop(job);
  }
  if (!status) {
    job.kill();
    notify(status);
    return status;
  }
  (void)silence_.record_probe(true, clock_.seconds(), clock_.seconds());
  notify({});
  status = keep(job);
  if (!options_.publish.empty()) client::remove_endpoint_file(options_.publish, published_);
  return status;
}

// Where the service stays however often it is started again.
Status Supervisor::publish() {
  if (options_.publish.empty()) return {};
  const std::string host = host_name();
  published_ = {options_.endpoint, host, std::to_string(getpid()), {}};
  for (const char* name : {"SLURM_JOB_ID", "PBS_JOBID"})
    if (const char* job = std::getenv(name); job != nullptr) published_.job = job;
  for (const std::string every : {"0.0.0.0:", "[::]:"})  // which is no address of a machine
    if (options_.endpoint.starts_with(every))
      published_.endpoint = fmt::format("{}:{}", host, options_.endpoint.substr(every.size()));
  if (!options_.endpoint.starts_with("unix:")) published_.token_file = join_path(options_.data_dir, kTokenFile);
  return client::write_endpoint_file(options_.publish, published_);
}

Status Supervisor::start(Job& job, bool restarted) {
  std::error_code ignored;
  std::filesystem::remove(marker_, ignored);
  log_.note(
      fmt::format("{} {} ranks on {}", restarted ? "starting again" : "starting", options_.ranks, options_.endpoint));
  log_.begin_job();
  started_ = clock_.seconds();
  silence_.begin(started_, options_.ready_seconds);
  return job.start(restarted);
}

Status Supervisor::await_first_answer(Job& job) {
  const double deadline = clock_.seconds() + options_.ready_seconds;
  while (clock_.seconds() < deadline) {
    if (wait(kProbeSeconds) == Events::Event::stop) {
      if (options_.embedded || !job.ready()) return {Code::aborted, "the service was told to end while it started"};
      stop(job);  // others may know already that it is up
      return {};
    }
    if (const auto end = job.poll()) {
      if (end->clean && job.ready()) return {};  // somebody was quicker than this process, and told it to end
      const bool by_signal = end->text.starts_with("signal");
      const std::string told = with_tail(fmt::format("the service ended ({})", end->text));
      return {Code::aborted, told,
              (by_signal ? "maybe a limit of this shell is too small (ulimit -a); " : "") + start_hint(told) +
                  log_hint("the whole log")};
    }
    // The job itself must be ready, too: another program may have taken its TCP port and answer there.
    if (job.ready() && ask_service(job, kProbeDeadlineSeconds) == Answer::heard) return {};
  }
  const std::string told =
      with_tail(fmt::format("the service did not answer within {} s of its start", options_.ready_seconds));
  return {Code::deadline_exceeded, told, start_hint(told) + log_hint("its log")};
}

// The log of a service for one command is removed with it.
std::string Supervisor::log_hint(const char* name) const {
  return options_.embedded ? "a service that rcbctl up starts keeps its log" : fmt::format("{}: {}", name, log_.path());
}

// What may have kept it from starting, unless it has itself told why. Whether processes can be started on other
// machines at all, mpirun alone tells soonest.
std::string Supervisor::start_hint(const std::string& told) const {
  if (told.find("\nrcbd: ") != std::string::npos) return "";
  const std::string& list = options_.hosts.list;
  const std::string odd = odd_surroundings(options_.hosts);
  return (list.empty() ? "" : fmt::format("does 'mpirun --host {} hostname' work? ", list)) + odd +
         (odd.empty() ? "" : "; ");
}

// Watches and restarts the service until it has ended for good.
Status Supervisor::keep(Job& job) {
  std::string why;
  bool dead = false;
  for (;;) {
    const auto outcome = go_on_after_faults([&] { return dead ? start_again(job, why) : watch(job, why); });
    if (!outcome) continue;
    dead = *outcome == Outcome::died && !options_.embedded;
    if (dead) continue;
    switch (*outcome) {
      case Outcome::running:
        continue;
      case Outcome::ended:
        return {};
      case Outcome::stopped:
        stop(job);
        return {};
      case Outcome::died:
        // The starter reads the log first, then closes the lifeline.
        while (wait(-1) != Events::Event::stop) continue;
        return {};
      case Outcome::displaced:
        return {Code::aborted, fmt::format("another service has taken {} meanwhile", options_.endpoint)};
    }
  }
}

// Nothing after a fault of this process's own: then the work is to be done again.
template <typename Work>
std::optional<Supervisor::Outcome> Supervisor::go_on_after_faults(const Work& work) {
  constexpr useconds_t kPauseMicroseconds = 500'000;
  try {
    const Outcome outcome = work();
    last_fault_.clear();
    return outcome;
  } catch (const std::exception& fault) {
    usleep(kPauseMicroseconds);
    try {
      if (last_fault_ != fault.what()) log_.note(fmt::format("this process has failed, and goes on: {}", fault.what()));
      last_fault_ = fault.what();
    } catch (const std::exception&) {  // no memory for that either
    }
  }
  return std::nullopt;
}

// The address at which the service has said that it listens, so that no name has to be looked up.
std::string Supervisor::where(Job& job) const {
  const std::string address = options_.endpoint.starts_with("unix:") ? "" : job.address();
  return address.empty() ? options_.endpoint : address;
}

Answer Supervisor::ask_service(Job& job, double deadline_seconds) {
  std::string why;
  const Answer answer = ask(where(job), deadline_seconds, why);
  if (answer == Answer::unasked && why != last_unasked_)
    log_.note(fmt::format("the service can't be asked whether it lives: {}", why));
  last_unasked_ = answer == Answer::unasked ? why : "";
  return answer;
}

// Probes the service; true if it has been silent for too long.
bool Supervisor::is_silent(Job& job) {
  const double asked_at = clock_.seconds();
  const Answer answer = ask_service(job, std::clamp(options_.ask_seconds, kAskSecondsLeast, kAskSecondsMost));
  if (answer != Answer::unasked) return silence_.record_probe(answer == Answer::heard, asked_at, clock_.seconds());
  silence_.skip_probe(clock_.seconds());
  return false;
}

// Waits until the service ends or is silent for too long. why: the reason of a death.
Supervisor::Outcome Supervisor::watch(Job& job, std::string& why) {
  for (;;) {
    if (const auto end = job.poll()) {
      why = with_tail(fmt::format("the service ended ({})", end->text));
      std::error_code unseen;  // a marker that can't be looked for: one that is started again can be ended again
      return end->clean || std::filesystem::exists(marker_, unseen) ? Outcome::ended : Outcome::died;
    }
    const double left = options_.embedded ? -1 : std::max(0.0, silence_.due() - clock_.seconds());
    if (wait(left) == Events::Event::stop) return Outcome::stopped;
    if (options_.embedded || clock_.seconds() < silence_.due() || job.poll()) continue;
    Status status = keep_place();
    if (status) status = log_.refresh();
    if (!status) {
      if (is_displaced(status)) return Outcome::displaced;
      if (status.message() != last_complaint_) log_.note(status.message());
      last_complaint_ = status.message();
    }
    if (is_silent(job)) {
      why = fmt::format("it has not answered for {:.0f} s", silence_.silent_seconds(clock_.seconds()));
      return Outcome::died;
    }
    if (clock_.seconds() - started_ > options_.backoff_reset_seconds && silence_.answered()) backoff_.reset();
  }
}

// Pauses and starts the job, until a start succeeds.
Supervisor::Outcome Supervisor::start_again(Job& job, std::string why) {
  for (;;) {
    job.kill();
    drain();
    ++note_.deaths;
    const double seconds = backoff_.next();
    note_.failures = backoff_.failures();
    note_.last_reason = why;
    // The reason's later lines are in the log already, above.
    log_.note(fmt::format("the service has died ({}), {} times so far, {} in a row; it is started again in {:.1f} s",
                          why.substr(0, why.find(":\n")), note_.deaths, note_.failures, seconds));
    tell_state(static_cast<double>(std::time(nullptr)) + seconds);
    if (!pause(seconds)) return Outcome::stopped;
    Status status = keep_place();
    if (is_displaced(status)) return Outcome::displaced;
    // Where the log belongs there may be something else now: then lines go on into the file that was opened last.
    (void)log_.refresh();
    if (status) status = start(job, true);
    if (status) {
      tell_state(0);
      return Outcome::running;
    }
    why = status.message();
  }
}

bool Supervisor::pause(double seconds) {
  const double due = clock_.seconds() + seconds;
  for (double left = seconds; left > 0; left = due - clock_.seconds())
    if (wait(left) == Events::Event::stop) return false;
  return true;
}

void Supervisor::tell_state(double start_at_unix) {
  note_.start_at_unix = start_at_unix;
  (void)endpoint_lock_->write(note_.text());  // overwritten in place, so that a full disk doesn't matter
}

// Creates again what somebody has removed: data directory and locks. Errors: why that can't be done; one is that
// another service has taken the endpoint.
Status Supervisor::keep_place() {
  if (!endpoint_lock_->in_place()) {
    auto lock = take_endpoint(note_);
    if (!lock.ok()) return lock.status();
    *endpoint_lock_ = std::move(*lock);
    log_.note(fmt::format("{} had been removed, and is made again", endpoint_lock_->path()));
  }
  if (!data_lock_->in_place()) {
    if (Status made = make_own_directory(options_.data_dir); !made.ok()) return made;
    auto lock = take_data_directory(note_);
    if (!lock.ok()) return lock.status();
    *data_lock_ = std::move(*lock);
    (void)log_.refresh();
    log_.note(fmt::format("the data directory {} had been removed, and is made again", options_.data_dir));
  }
  return {};
}

// Ends the service cleanly within kStopSeconds, if possible; run() kills what is left.
void Supervisor::stop(Job& job) {
  if (options_.embedded || !job.running()) return;  // an embedded service keeps nothing
  log_.note("stopping");
  const double began = clock_.seconds();
  std::string token;  // of a service on TCP; the library doesn't look for it in a data directory that the user named
  std::ifstream(join_path(options_.data_dir, kTokenFile)) >> token;
  auto client = reach(where(job), "rcbctl up", 2, token);
  const bool told = client && client->shutdown_service();
  // A batch system sends SIGTERM to all processes of a job at once: then the ranks are ending by themselves.
  const double deadline = began + (told ? kStopSeconds : kUntoldSeconds);
  while (job.running() && clock_.seconds() < deadline) {
    (void)wait(0.1);
    if (job.poll()) return;
  }
}

std::string Supervisor::with_tail(const std::string& text) {
  drain();
  const std::string tail = log_.tail();
  return tail.empty() ? text : text + ":\n" + tail;
}

void Supervisor::notify(const Status& status) {
  if (options_.notify_fd < 0) return;
  std::string text(1, status ? kReady : kFailed);
  if (!status)
    for (const std::string& field : {std::string(code_name(status.code())), status.message(), status.hint()})
      text.append(field).push_back('\0');
  // The starter may have gone: then nobody needs the message.
  if (write(options_.notify_fd, text.data(), text.size()) < 0) log_.note("the starter has gone");
}

}  // namespace

std::string log_path(const std::string& data_dir) { return join_path(data_dir, kLogFile); }

Status supervise(const SuperviseOptions& options) { return Supervisor(options).run(); }

}  // namespace rcb::launch
