#include "server/ranks/engine_loop.hpp"

#include <algorithm>
#include <optional>
#include <set>
#include <string>
#include <utility>

#include "server/api/commands.hpp"

namespace rcb::ranks {

bool EngineLoop::push(EngineOrder order) {
  const std::lock_guard lock(mutex_);
  if (queue_.size() >= capacity_) return false;
  queue_.push_back(std::move(order));
  filled_.notify_one();
  return true;
}

EngineOrder EngineLoop::next() {
  std::unique_lock lock(mutex_);
  // No deadline here: an idle engine may sleep for ever. The I/O thread ends the process if the peers are lost.
  filled_.wait(lock, [this] { return !queue_.empty(); });
  EngineOrder order = std::move(queue_.front());
  queue_.pop_front();
  return order;
}

namespace {

// A field of text; empty where it isn't there, or is something else, which the command itself will refuse.
std::string text_field(const EngineOrder& order, const char* name) {
  const auto field = order.request.find(name);
  return field != order.request.end() && field->is_string() ? field->get<std::string>() : std::string();
}

bool is_shutdown(const EngineOrder& order) { return text_field(order, "command") == "shutdown"; }

const api::CommandInfo* command_of(const EngineOrder& order) { return api::find_command(text_field(order, "command")); }

bool gives_way(const EngineOrder& order) {
  const api::CommandInfo* command = command_of(order);
  return command != nullptr && command->gives_way;
}

bool for_rank_0_alone(const EngineOrder& order) {
  const api::CommandInfo* command = command_of(order);
  return command != nullptr && command->runs_on == api::RunsOn::root;
}

}  // namespace

// An order is passed over if it may last itself, or is of the scene of one being executed, or of one passed over that
// changes it. Which
// ones these are follows from the orders up to the newest alone, so every rank passes over the same.
class EngineLoop::Others final : public service::WaitingOrders {
 public:
  Others(EngineLoop& loop, service::Service& service, const EngineOrder& running)
      : loop_(loop), service_(service), scene_(text_field(running, "scene")) {}

  // None until the command has worked for as long as it gave way the last time: under any load half of the time is its.
  std::uint64_t newest() override {
    newest_here_ = 0;
    if (Clock::now() - resumed_ < given_) return 0;
    const std::lock_guard lock(loop_.mutex_);
    newest_here_ = loop_.queue_.empty() ? 0 : loop_.queue_.back().number;
    std::uint64_t newest = 0;
    std::set<std::string> passed_over{scene_};
    for (const EngineOrder& order : loop_.queue_)
      if (may_go(order, passed_over) && !for_rank_0_alone(order)) newest = order.number;
    return newest;
  }

  // Rank 0 also executes those that it alone has, whatever the newest of all ranks'.
  void execute(std::uint64_t newest) override {
    newest = std::max(newest, std::exchange(newest_here_, 0));
    if (newest == 0) return;
    std::vector<EngineOrder> orders;
    {
      std::unique_lock lock(loop_.mutex_);
      // It comes: rank 0 has sent it. No deadline, as in next().
      loop_.filled_.wait(lock, [&] { return !loop_.queue_.empty() && loop_.queue_.back().number >= newest; });
      std::set<std::string> passed_over{scene_};
      std::deque<EngineOrder> left;
      for (EngineOrder& order : loop_.queue_) {
        const bool goes = order.number <= newest && may_go(order, passed_over);
        if (goes)
          orders.push_back(std::move(order));
        else
          left.push_back(std::move(order));
      }
      loop_.queue_ = std::move(left);
    }
    const Clock::time_point began = Clock::now();
    const std::uint64_t number = loop_.number_running_.load(std::memory_order_relaxed);
    const double deadline = loop_.deadline_running_.load(std::memory_order_relaxed);
    for (EngineOrder& order : orders) loop_.execute(service_, std::move(order));
    loop_.deadline_running_.store(deadline, std::memory_order_relaxed);
    loop_.number_running_.store(number, std::memory_order_relaxed);
    resumed_ = Clock::now();
    given_ = resumed_ - began;
  }

 private:
  using Clock = std::chrono::steady_clock;

  static bool may_go(const EngineOrder& order, std::set<std::string>& passed_over) {
    const std::string scene = text_field(order, "scene");
    // What only reads and may last itself holds up nobody before it has begun.
    if (gives_way(order) && !api::changes_scene(order.request, *command_of(order))) return false;
    if (!is_shutdown(order) && !gives_way(order) && !passed_over.contains(scene)) return true;
    passed_over.insert(scene);
    return false;
  }

  EngineLoop& loop_;
  service::Service& service_;
  std::string scene_;  // of the order being executed
  std::uint64_t newest_here_ = 0;
  Clock::time_point resumed_;
  Clock::duration given_{};
};

void EngineLoop::execute(service::Service& service, EngineOrder order) {
  deadline_running_.store(order.deadline_seconds, std::memory_order_relaxed);
  number_running_.store(order.number, std::memory_order_relaxed);
  service::Response response;
  const std::chrono::duration<double> waited = std::chrono::steady_clock::now() - order.ordered;
  std::optional<Others> others;
  if (gives_way(order)) others.emplace(*this, service, order);
  if (!is_shutdown(order))
    response = service.execute(order.request, std::move(order.slices),
                               {.received_seconds = order.received_seconds,
                                .seconds_left = order.deadline_seconds - waited.count(),
                                .cancelled = order.cancelled,
                                .waiting = others ? &*others : nullptr});
  number_running_.store(0, std::memory_order_relaxed);
  for (service::Spare& spare : service.take_spares())
    if (handlers_.spare) handlers_.spare(std::move(spare));
  if (order.done) order.done(std::move(response));
  if (handlers_.executed) handlers_.executed();
}

void EngineLoop::run(service::Service& service) {
  for (bool last = false; !last;) {
    EngineOrder order = next();
    last = is_shutdown(order);
    execute(service, std::move(order));
  }
}

}  // namespace rcb::ranks
