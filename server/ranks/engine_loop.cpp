#include "server/ranks/engine_loop.hpp"

#include <algorithm>
#include <utility>

namespace rcb::ranks {

namespace {

// How often MPI is called after an order, and how long.
constexpr std::chrono::milliseconds kPauseLeast(1);
constexpr std::chrono::milliseconds kPauseMost(1000);
constexpr std::chrono::milliseconds kProgressMost = std::chrono::minutes(2);

bool is_shutdown(const EngineOrder& order) { return order.request.value("command", "") == "shutdown"; }

}  // namespace

bool EngineLoop::push(EngineOrder order) {
  const api::CommandInfo* command = api::find_command(order.request.value("command", ""));
  const std::lock_guard lock(mutex_);
  if (queue_.size() >= capacity_) return false;
  queue_.push_back({std::move(order), command});
  filled_.notify_one();
  return true;
}

template <typename Filled>
void EngineLoop::wait(std::unique_lock<std::mutex>& lock, const Filled& filled) {
  auto pause = kPauseLeast;
  for (auto waited = pause; handlers_.progress && waited < kProgressMost; waited += pause) {
    if (filled_.wait_for(lock, pause, filled)) return;
    lock.unlock();
    handlers_.progress();
    lock.lock();
    pause = std::min(2 * pause, kPauseMost);
  }
  filled_.wait(lock, filled);
}

EngineLoop::Queued EngineLoop::next() {
  std::unique_lock lock(mutex_);
  wait(lock, [this] { return !queue_.empty(); });
  Queued next = std::move(queue_.front());
  queue_.pop_front();
  return next;
}

std::optional<EngineLoop::Queued> EngineLoop::next_up_to(std::uint64_t newest) {
  const std::lock_guard lock(mutex_);
  if (queue_.empty() || queue_.front().order.number > newest) return std::nullopt;
  Queued next = std::move(queue_.front());
  queue_.pop_front();
  return next;
}

// The orders queued behind a running command that gives way.
class EngineLoop::OrdersBehind final : public service::WaitingOrders {
 public:
  OrdersBehind(EngineLoop& loop, service::Service& service) : loop_(loop), service_(service) {}

  // 0 until the command has worked for as long as it last gave way: so at least half of the time is the command's.
  std::uint64_t newest() override {
    newest_here_ = 0;
    if (Clock::now() - resumed_ < given_) return 0;
    const std::lock_guard lock(loop_.mutex_);
    std::uint64_t newest = 0;  // of those that come to all ranks
    for (const Queued& queued : loop_.queue_) {
      newest_here_ = queued.order.number;
      if (queued.command == nullptr || queued.command->runs_on != api::RunsOn::root) newest = newest_here_;
    }
    return newest;
  }

  // Rank 0 also executes waiting orders that only it has, even if they are newer than the newest of all ranks.
  void execute(std::uint64_t newest) override {
    newest = std::max(newest, std::exchange(newest_here_, 0));
    if (newest == 0) return;
    const Clock::time_point began = Clock::now();
    const std::uint64_t number = loop_.number_running_.load(std::memory_order_relaxed);
    const double deadline = loop_.deadline_running_.load(std::memory_order_relaxed);
    {
      std::unique_lock lock(loop_.mutex_);
      // The order `newest` will arrive, since rank 0 has sent it.
      loop_.wait(lock, [&] { return !loop_.queue_.empty() && loop_.queue_.back().order.number >= newest; });
    }
    // One at a time: if one of them gives way itself, it executes orders behind it from the queue.
    while (auto order = loop_.next_up_to(newest)) loop_.execute(service_, std::move(*order));
    loop_.deadline_running_.store(deadline, std::memory_order_relaxed);
    loop_.number_running_.store(number, std::memory_order_relaxed);
    resumed_ = Clock::now();
    given_ = resumed_ - began;
  }

 private:
  using Clock = std::chrono::steady_clock;

  EngineLoop& loop_;
  service::Service& service_;
  std::uint64_t newest_here_ = 0;  // on rank 0
  Clock::time_point resumed_;
  Clock::duration given_{};
};

void EngineLoop::execute(service::Service& service, Queued queued) {
  EngineOrder& order = queued.order;
  deadline_running_.store(order.deadline_seconds, std::memory_order_relaxed);
  number_running_.store(order.number, std::memory_order_relaxed);
  service::Response response;
  const std::chrono::duration<double> waited = std::chrono::steady_clock::now() - order.ordered;
  OrdersBehind behind(*this, service);
  if (!is_shutdown(queued.order))
    response = service.execute(order.request, std::move(order.slices),
                               {.received_seconds = order.received_seconds,
                                .seconds_left = order.deadline_seconds - waited.count(),
                                .cancelled = order.cancelled,
                                .waiting = queued.command != nullptr && queued.command->gives_way ? &behind : nullptr});
  number_running_.store(0, std::memory_order_relaxed);
  if (order.done) order.done(std::move(response));
  if (handlers_.executed) handlers_.executed();
}

void EngineLoop::run(service::Service& service) {
  for (bool last = false; !last;) {
    Queued queued = next();
    last = is_shutdown(queued.order);
    execute(service, std::move(queued));
  }
}

}  // namespace rcb::ranks
