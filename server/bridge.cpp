#include "server/bridge.hpp"

#include <memory>
#include <utility>

#include "server/api/commands.hpp"

namespace rcb::server {
namespace {

constexpr std::uint64_t kBytesAheadMax = std::uint64_t{64} << 20U;

// All observers of slices are these.
class Observer final : public net::SliceObserver {
 public:
  explicit Observer(std::shared_ptr<service::Arrival> arrival) : arrival_(std::move(arrival)) {}
  void arrived(std::size_t axis, std::uint64_t first, std::span<const double> values) override {
    arrival_->add(axis, first, values);
  }
  std::shared_ptr<const service::Arrival> arrival() const { return arrival_; }

 private:
  std::shared_ptr<service::Arrival> arrival_;
};

std::vector<service::PushSlice> convert(std::vector<net::Slice> from) {
  std::vector<service::PushSlice> to;
  for (net::Slice& slice : from) {
    to.push_back({slice.rank, slice.count, std::move(slice.arrays)});
    if (slice.observer) to.back().arrival = static_cast<const Observer&>(*slice.observer).arrival();
  }
  return to;
}

}  // namespace

net::DataPort::Watch watch_arrivals(service::Loans& loans) {
  return [&loans](const net::PushTerms& terms) -> std::shared_ptr<net::SliceObserver> {
    auto arrival = loans.begin(terms.id.scene, terms.dims, terms.n);
    return arrival ? std::make_shared<Observer>(std::move(arrival)) : nullptr;
  };
}

std::vector<service::PushSlice> staged_slices(net::DataPort& data, const wire::Json& request) {
  const auto staged = request.find("staged");
  if (staged == request.end()) return {};
  if (!staged->is_array()) return convert(data.take(staged->get<std::uint64_t>()));
  std::vector<service::PushSlice> slices;
  for (std::size_t member = 0; member < staged->size(); ++member)
    for (service::PushSlice& slice : convert(data.take((*staged)[member].get<std::uint64_t>()))) {
      slice.rank = static_cast<int>(member);
      slices.push_back(std::move(slice));
    }
  return slices;
}

Bridge::Bridge(ranks::EngineLoop& engine, net::DoorbellHub& doorbells, net::DataPort& data, int ranks)
    : engine_(engine), doorbells_(doorbells), data_(data), credits_(ranks - 1, kOrdersAheadMax, kBytesAheadMax) {}

void Bridge::submit(net::Order order, std::function<void(net::Answer)> done) {
  const auto* command = api::find_command(order.request.value("command", ""));
  const bool root_alone = command != nullptr && command->runs_on == api::RunsOn::root;
  Waiting next{std::move(order), std::move(done), !root_alone};
  if (root_alone || (waiting_.empty() && may_go(next)))
    send(std::move(next));
  else
    waiting_.push_back(std::move(next));
}

void Bridge::executed(int rank, std::uint64_t orders) {
  credits_.executed(rank, orders);
  while (!waiting_.empty() && may_go(waiting_.front())) {
    Waiting next = std::move(waiting_.front());
    waiting_.pop_front();
    send(std::move(next));
  }
}

void Bridge::send(Waiting next) {
  net::Order& order = next.order;
  ranks::EngineOrder out;
  out.number = ++number_;
  out.slices = staged_slices(data_, order.request);
  for (service::PushSlice& slice : convert(std::move(order.slices))) out.slices.push_back(std::move(slice));
  out.request = std::move(order.request);
  out.received_seconds = order.received_seconds;
  out.deadline_seconds = order.deadline_seconds;
  out.cancelled = std::move(order.cancelled);
  out.done = [done = std::move(next.done)](service::Response response) {
    done(
        {std::move(response.status), std::move(response.json), std::move(response.arrays), std::move(response.change)});
  };
  // This rank's engine wakes while the others are rung: a command that needs none of them is answered meanwhile.
  CHECK(engine_.push(std::move(out)), "the engine's queue is full");
  if (!next.on_all_ranks) return;
  credits_.sent(order.text.size());
  doorbells_.ring(number_, order.text);
}

bool Watchdog::tick() {
  const std::uint64_t running = engine_.number_running();
  ticks_ = running != 0 && running == number_ ? ticks_ + 1 : 0;
  number_ = running;
  return running != 0 && seconds() > engine_.deadline_running_seconds() + stall_seconds_;
}

}  // namespace rcb::server
