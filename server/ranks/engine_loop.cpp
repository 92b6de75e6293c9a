#include "server/ranks/engine_loop.hpp"

#include <utility>

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

void EngineLoop::run(service::Service& service) {
  while (true) {
    EngineOrder order = next();
    const bool last = order.request.value("command", "") == "shutdown";
    deadline_running_.store(order.deadline_seconds, std::memory_order_relaxed);
    number_running_.store(order.number, std::memory_order_relaxed);
    service::Response response;
    const std::chrono::duration<double> waited = std::chrono::steady_clock::now() - order.ordered;
    if (!last)
      response = service.execute(order.request, std::move(order.slices),
                                 {order.received_seconds, order.deadline_seconds - waited.count(), order.cancelled});
    number_running_.store(0, std::memory_order_relaxed);
    for (service::Spare& spare : service.take_spares())
      if (handlers_.spare) handlers_.spare(std::move(spare));
    if (order.done) order.done(std::move(response));
    if (handlers_.executed) handlers_.executed();
    if (last) return;
  }
}

}  // namespace rcb::ranks
