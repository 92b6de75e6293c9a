#include "server/net/control/order_queue.hpp"

#include <utility>

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include "server/api/commands.hpp"

namespace rcb::net {

namespace {

// A field of text; empty where it isn't there, or is something else, which the command itself will refuse.
std::string text_field(const wire::Json& request, const char* name) {
  const auto field = request.find(name);
  return field != request.end() && field->is_string() ? field->get<std::string>() : std::string();
}

}  // namespace

void OrderQueue::add(Order order, Done done) {
  Waiting next{.order = std::move(order), .done = std::move(done), .scene = {}};
  next.scene = text_field(next.order.request, "scene");
  const std::string name = text_field(next.order.request, "command");
  next.is_end = name == "shutdown";
  const api::CommandInfo* command = api::find_command(name);
  if (next.is_end || (command != nullptr && command->gives_way))
    next.kind = api::changes_scene(next.order.request, *command) ? Kind::long_changing : Kind::long_reading;
  waiting_.push_back(std::move(next));
  release();
}

void OrderQueue::executed(int rank, std::uint64_t orders) {
  credits_.executed(rank, orders);
  release();
}

void OrderQueue::long_order_ended(Kind kind) {
  (kind == Kind::long_reading ? reading_ : changing_).reset();
  release();
}

void OrderQueue::drop_cancelled() {
  for (Waiting& one : waiting_)
    if (one.order.cancelled && *one.order.cancelled)
      one.done({.status = {Code::aborted, "the command was given up before it was begun"}});
  std::erase_if(waiting_, [](const Waiting& one) { return one.order.cancelled && *one.order.cancelled; });
  release();  // what waited behind them
}

bool OrderQueue::long_one_may_start(const Waiting& one) const {
  return !changing_ && (!reading_ || (one.kind == Kind::long_changing && !one.is_end));
}

void OrderQueue::release() {
  std::set<std::string> passed_over;  // scenes with an earlier order that must be sent or end first
  std::deque<Waiting> left;
  for (Waiting& one : std::exchange(waiting_, {})) {
    for (const auto& scene : {reading_, changing_})
      if (scene) passed_over.insert(*scene);
    const bool turn =
        one.is_end ? left.empty() : !passed_over.contains(one.scene);  // after the end nothing is answered
    if (turn && credits_.room(one.order.text.size()) && (one.kind == Kind::brief || long_one_may_start(one))) {
      send(std::move(one));
    } else {
      if (one.kind != Kind::long_reading) passed_over.insert(one.scene);
      left.push_back(std::move(one));
    }
  }
  waiting_ = std::move(left);
}

// Whatever is wrong with one order concerns neither those behind it nor whoever made room for it.
void OrderQueue::send(Waiting one) {
  const std::uint64_t bytes = one.order.text.size();
  try {
    send_(std::move(one.order), std::move(one.done), one.kind);
  } catch (const std::exception& fault) {
    spdlog::error("an order can't be sent: {}", fault.what());
    return one.done({.status = {Code::internal, fmt::format("an internal fault: {}", fault.what())}});
  }
  credits_.sent(bytes);
  if (one.kind == Kind::long_reading) reading_ = one.scene;
  if (one.kind == Kind::long_changing) changing_ = one.scene;
}

}  // namespace rcb::net
