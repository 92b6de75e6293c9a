// Clients: connecting, turns, notices, and the thread for steps that were begun.
#include "client/c/client.hpp"

#include <algorithm>
#include <chrono>
#include <system_error>
#include <utility>

#include <fmt/format.h>
#include <unistd.h>

#include "client/c/call.hpp"
#include "client/c/scene.hpp"
#include "client/c/step.hpp"
#include "client/c/structs.hpp"
#include "common/base/signals.hpp"

namespace rcb::c {
namespace {

using Clock = std::chrono::steady_clock;

constexpr std::chrono::milliseconds kBetweenStops(50);  // a signal handler can't notify

Clock::duration wait_of(double seconds) {
  const double least = seconds > 0 ? std::min(seconds, wire::kDeadlineSecondsMax) : 0;  // NaN: 0
  return std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(least));
}

// So that messages tell which of several processes it is.
std::string with_pid(const char* name) { return fmt::format("{} (pid {})", name, ::getpid()); }

}  // namespace

Status check_deadline(double seconds) {
  if (seconds > 0) return {};
  return {Code::invalid_argument, fmt::format("a deadline of {} seconds", seconds), "give a number above 0"};
}

Left::Left(double seconds) : until_(Clock::now() + wait_of(seconds)) {}

double Left::seconds() const { return std::max(std::chrono::duration<double>(until_ - Clock::now()).count(), 0.001); }

Status Turns::take(double seconds, const std::function<bool()>& stop) {
  std::unique_lock lock(mutex_);
  const auto until = Clock::now() + wait_of(seconds);
  while (taken_) {
    const auto now = Clock::now();
    if (now >= until)
      return {Code::busy, "another call of this client, in another thread, is still under way",
              "wait for it, or give each thread a client of its own"};
    given_.wait_for(lock, std::min<Clock::duration>(until - now, kBetweenStops));
    if (stop()) {
      given_.notify_one();  // this may have been the one that was told
      return {Code::interrupted, "interrupted; another call of this client was still under way"};
    }
  }
  taken_ = true;
  return {};
}

void Turns::take() {
  std::unique_lock lock(mutex_);
  given_.wait(lock, [this] { return !taken_; });  // as long as the call under way may take, which has a deadline
  taken_ = true;
}

void Turns::give() {
  const std::lock_guard lock(mutex_);
  taken_ = false;
  given_.notify_one();
}

void Notices::add(const std::string& text) {
  const std::lock_guard lock(mutex_);
  if (texts_.size() == kMost) texts_.pop_front();
  texts_.push_back(text);
}

std::optional<std::string> Notices::take() {
  const std::lock_guard lock(mutex_);
  if (texts_.empty()) return std::nullopt;
  std::optional<std::string> text(std::move(texts_.front()));
  texts_.pop_front();
  return text;
}

Worker::~Worker() {
  {
    const std::lock_guard lock(mutex_);
    ending_ = true;
    changed_.notify_all();
  }
  if (thread_.joinable()) thread_.join();
}

Status Worker::add(rcbd_op& op) {
  const std::lock_guard lock(mutex_);
  if (!thread_.joinable()) try {
      const SignalsBlocked blocked;
      thread_ = std::thread([this] { run(); });
    } catch (const std::system_error& fault) {
      return {Code::unavailable, fmt::format("there is no thread for the step: {}", fault.what()),
              "see ulimit -u, or use rcbd_step"};
    }
  begun_.push_back(&op);
  changed_.notify_all();
  return {};
}

bool Worker::wait(const rcbd_op& op, double seconds) {
  std::unique_lock lock(mutex_);
  const auto done = [&op] { return op.done; };
  if (seconds >= 0) return changed_.wait_for(lock, wait_of(seconds), done);
  changed_.wait(lock, done);  // a step ends at its deadline
  return true;
}

void Worker::run() {
  const DefaultFloatingPoint guard;
  std::unique_lock lock(mutex_);
  while (true) {
    changed_.wait(lock, [this] { return ending_ || !begun_.empty(); });
    if (begun_.empty()) return;
    rcbd_op& op = *begun_.front();
    begun_.pop_front();
    lock.unlock();
    op.run();
    lock.lock();
    op.done = true;  // from here on its last holder may free it
    changed_.notify_all();
  }
}

}  // namespace rcb::c

using namespace rcb;  // NOLINT: the functions below are not of a namespace

Status rcbd_client::connect(client::ConnectOptions options) {
  options.on_notice = [this](const std::string& text) { notices.add(text); };
  options.on_wait = [this] { return !interrupts.answer() && (cancelled == nullptr || !cancelled->load()); };
  auto connected = client::Client::connect(options);
  if (connected) client.emplace(std::move(*connected));
  return connected.status();
}

Status rcbd_client::close() {
  turns.take();
  const Turn turn(*this);
  for (rcbd_scene* const one : scenes) one->scene.reset();
  scenes.clear();
  client.reset();
  return {};
}

int rcbd_connect(const char* endpoint, const rcbd_connect_options* options, rcbd_client** to) {
  return c::call([&]() -> Status {
    if (to == nullptr) return {Code::invalid_argument, "no room for the client: a null pointer"};
    *to = nullptr;
    auto given = c::read_struct(options, rcbd_connect_options RCBD_CONNECT_OPTIONS, "RCBD_CONNECT_OPTIONS");
    if (!given) return given.status();
    const std::string_view way = given->path == nullptr ? "auto" : given->path;
    const auto path = client::path_from_name(way);
    if (!path)
      return {Code::invalid_argument, fmt::format("the path '{}'", way), "give auto, shared, direct or gateway"};
    auto made = std::make_unique<rcbd_client>();
    Status status = made->connect({.endpoint = endpoint == nullptr ? "" : endpoint,
                                   .deadline_seconds = given->deadline_seconds,
                                   .name = c::with_pid(given->name == nullptr ? "librcbd" : given->name),
                                   .token = given->token == nullptr ? "" : given->token,
                                   .path = *path,
                                   .outlive = given->outlive != 0});
    if (status) *to = made.release();
    return status;
  });
}

const char* rcbd_notice(rcbd_client* client) {
  static thread_local std::string last;
  bool found = false;
  c::call([&]() -> Status {
    if (Status usable = c::check(client); !usable) return usable;
    auto text = client->notices.take();
    if (text) last = std::move(*text);
    found = text.has_value();
    return {};
  });
  return found ? last.c_str() : nullptr;
}

void rcbd_interrupt(rcbd_client* client) {
  if (c::usable(client)) client->interrupts.ask();
}
