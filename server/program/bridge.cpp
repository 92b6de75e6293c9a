#include "server/program/bridge.hpp"

#include <algorithm>
#include <memory>
#include <utility>

#include "server/api/commands.hpp"

namespace rcb::server {
namespace {

constexpr std::uint64_t kBytesAheadMax = std::uint64_t{64} << 20U;

// The memory that the client of a block shares with this rank. What the block says was checked before it was ordered.
void add_shared(const net::DataPort& data, const wire::Json& block, api::Slice& slice) {
  auto arrays = api::read_shared(block);
  RCB_CHECK(arrays.ok(), arrays.status().message());
  const auto session = block.at("session").get<std::string>();
  for (api::SharedArray& where : *arrays) {
    auto memory = data.memory(session, where.memory);
    slice.shared.push_back({std::move(where), std::move(memory)});
  }
  slice.rows = block.at("n").get<std::uint64_t>();
  slice.is_float32 = block.at("dtype") == "<f4";
}

// Whether this rank's rows come from memory: all that it reads for a block by the way "shared-memory", but for the
// ranks that have theirs by socket.
bool from_memory(const net::DataPort& data, const wire::Json& block) {
  return block.at("way") == "shared-memory" && std::ranges::count(block.at("sockets"), wire::Json(data.rank())) == 0;
}

}  // namespace

std::vector<api::Slice> staged_slices(net::DataPort& data, const wire::Json& request) {
  std::vector<api::Slice> slices;
  const auto blocks = request.find("blocks");
  if (blocks == request.end()) return slices;
  for (const wire::Json& block : *blocks) {
    if (block.at("way") == "endpoint") continue;
    api::Slice slice;
    const auto counts = block.find("counts");
    for (int rank = 0; counts != block.end() && rank <= data.rank(); ++rank) {
      slice.first_row += slice.count;
      slice.count = counts->at(static_cast<std::size_t>(rank)).get<std::uint64_t>();
    }
    if (counts != block.end() && slice.count == 0) continue;
    if (from_memory(data, block)) {
      add_shared(data, block, slice);
    } else {
      auto taken = data.take(block.at("number").get<std::uint64_t>());
      if (!taken) continue;
      taken->first_row = slice.first_row;
      slice = std::move(*taken);
    }
    slice.seat = block.at("seat").get<int>();
    slices.push_back(std::move(slice));
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
