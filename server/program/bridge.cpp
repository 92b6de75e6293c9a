#include "server/program/bridge.hpp"

#include <algorithm>
#include <memory>
#include <utility>

#include "server/api/commands.hpp"

namespace rcb::server {
namespace {

constexpr std::uint64_t kBytesAheadMax = std::uint64_t{64} << 20U;

// What a push, or a member's contribution, has in memory that its client shares with this rank. What `push` says was
// checked before it was ordered.
api::Slice shared_slice(const net::DataPort& data, const wire::Json& push) {
  api::Slice slice{.rank = data.rank()};
  auto arrays = api::read_shared(push);
  RCB_CHECK(arrays.ok(), arrays.status().message());
  const auto session = push.at("session").get<std::string>();
  for (api::SharedArray& where : *arrays) {
    auto memory = data.memory(session, where.memory);
    slice.shared.push_back({std::move(where), std::move(memory)});
  }
  slice.rows = push.at("n").get<std::uint64_t>();
  slice.is_float32 = push.value("dtype", "") == "<f4";
  return slice;
}

// Whether this rank's particles come over its socket, though the push is one from shared memory.
bool by_socket(const net::DataPort& data, const wire::Json& push) {
  const auto ranks = push.find("sockets");
  return ranks != push.end() && std::find(ranks->begin(), ranks->end(), data.rank()) != ranks->end();
}

// The same in order "plan": the push says how many of its rows are on each rank.
api::Slice shared_slice_by_slot(const net::DataPort& data, const wire::Json& push) {
  api::Slice slice = shared_slice(data, push);
  const auto counts = push.find("counts");
  if (counts == push.end() || counts->empty()) return slice;  // of a step that is committed already
  for (int rank = 0; rank <= data.rank(); ++rank) {
    slice.first_row += slice.count;
    slice.count = counts->at(static_cast<std::size_t>(rank)).get<std::uint64_t>();
  }
  return slice;
}

}  // namespace

std::vector<api::Slice> staged_slices(net::DataPort& data, const wire::Json& request) {
  if (request.value("command", "") == "push" && request.value("path", wire::Json()) == "shared" &&
      !by_socket(data, request))
    return {request.value("order", "") == "plan" ? shared_slice_by_slot(data, request) : shared_slice(data, request)};
  const auto staged = request.find("staged");
  if (staged == request.end()) return {};
  if (!staged->is_array()) return data.take(staged->get<std::uint64_t>());
  std::vector<api::Slice> slices;
  for (std::size_t member = 0; member < staged->size(); ++member) {
    const wire::Json& one = (*staged)[member];
    std::vector<api::Slice> of_member;
    if (one.is_object() && !by_socket(data, one))
      of_member.push_back(shared_slice_by_slot(data, one));
    else
      of_member = data.take(one.is_object() ? one.at("number").get<std::uint64_t>() : one.get<std::uint64_t>());
    for (api::Slice& slice : of_member) {
      slice.member = static_cast<int>(member);
      if (slice.count > 0) slices.push_back(std::move(slice));
    }
  }
  return slices;
}

Bridge::Bridge(net::IoLoop& loop, ranks::EngineLoop& engine, net::DoorbellHub& doorbells, net::DataPort& data,
               int ranks)
    : loop_(loop),
      engine_(engine),
      doorbells_(doorbells),
      data_(data),
      queue_(net::Credits(ranks - 1, kOrdersAheadMax, kBytesAheadMax),
             [this](net::Order&& order, net::OrderQueue::Done&& done, net::OrderQueue::Kind kind) {
               send_to_all(std::move(order), std::move(done), kind);
             }) {}

void Bridge::submit(net::Order order, std::function<void(net::Answer)> done) {
  const auto* command = api::find_command(order.request.value("command", ""));
  if (command != nullptr && command->runs_on == api::RunsOn::root)
    send_to_rank_0(std::move(order), {}, std::move(done));
  else
    queue_.add(std::move(order), std::move(done));
}

void Bridge::send_to_all(net::Order&& order, net::OrderQueue::Done&& done, net::OrderQueue::Kind kind) {
  std::vector<api::Slice> slices = staged_slices(data_, order.request);
  if (kind != net::OrderQueue::Kind::brief)
    done = [this, kind, done = std::move(done)](net::Answer answer) {
      done(std::move(answer));
      loop_.post([this, kind] { queue_.long_order_ended(kind); });
    };
  const std::string text = std::move(order.text);
  // First this rank's engine, so that it wakes up while the other ranks are notified.
  send_to_rank_0(std::move(order), std::move(slices), std::move(done));
  ring(text);
}

void Bridge::send_to_rank_0(net::Order order, std::vector<api::Slice> slices, net::OrderQueue::Done done) noexcept {
  ranks::EngineOrder out;
  out.number = ++number_;
  out.slices = std::move(slices);
  for (api::Slice& slice : order.slices) out.slices.push_back(std::move(slice));
  out.request = std::move(order.request);
  out.received_seconds = order.received_seconds;
  out.deadline_seconds = order.deadline_seconds;
  out.cancelled = std::move(order.cancelled);
  out.done = std::move(done);
  RCB_CHECK(engine_.push(std::move(out)), "the engine's queue is full");
}

}  // namespace rcb::server
