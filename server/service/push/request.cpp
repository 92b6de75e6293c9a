#include "server/service/push/request.hpp"

#include <algorithm>
#include <utility>

#include <fmt/format.h>

#include "common/wire/field_reader.hpp"
#include "common/wire/limits.hpp"

namespace rcb::service {
namespace {

Result<Block> read_block(const wire::Json& json, int ranks) {
  wire::FieldReader fields(json);
  Block block;
  block.seat = static_cast<int>(fields.integer_or("seat", 0, wire::kSeatsMax, 0));
  block.n = fields.particles("n");
  block.way = api::read_way(fields);
  block.is_float32 = fields.word("dtype", {"<f8", "<f4"}) == "<f4";
  for (const double count : fields.numbers("counts", static_cast<std::size_t>(ranks)))
    block.counts.push_back(static_cast<std::uint64_t>(count));
  if (!fields.ok()) return fields.status();
  if (!block.counts.empty() && block.counts.size() != static_cast<std::size_t>(ranks))
    return Status(Code::invalid_argument, "a block's counts aren't those of all ranks");
  return block;
}

// Of all blocks together.
api::Way way_of(const std::vector<Block>& blocks) {
  const auto by = [](api::Way way) { return [way](const Block& block) { return block.way == way; }; };
  if (std::ranges::any_of(blocks, by(api::Way::sockets))) return api::Way::sockets;
  const bool shared = !blocks.empty() && std::ranges::all_of(blocks, by(api::Way::shared_memory));
  return shared ? api::Way::shared_memory : api::Way::endpoint;
}

}  // namespace

Result<PushRequest> read_order(const wire::Json& request, int ranks) {
  wire::FieldReader fields(request);
  api::PushId id{.scene = fields.text("scene", 64)};
  id.step = fields.integer("step", 0, wire::kStepMax);
  PushRequest order;
  order.seats = static_cast<int>(fields.integer_or("seats", 1, wire::kSeatsMax, 1));
  if (!fields.ok()) return fields.status();
  auto push = api::read_push(request, std::move(id), ranks);
  if (!push.ok()) return push.status();
  static_cast<api::Push&>(order) = std::move(*push);
  if (const auto terms = request.find("terms"); terms != request.end()) order.terms = scene::read_terms(*terms);
  if (const auto sum = request.find("counted_ids"); sum != request.end()) order.counted_ids = sum->get<std::uint64_t>();
  const auto blocks = request.find("blocks");
  std::uint64_t n = 0;
  if (blocks != request.end() && blocks->is_array())
    for (const wire::Json& one : *blocks) {
      auto block = read_block(one, ranks);
      if (!block.ok()) return block.status();
      n += block->n;
      order.blocks.push_back(*block);
    }
  order.way = way_of(order.blocks);
  if (n != order.n)
    return Status(Code::invalid_argument, fmt::format("the blocks have {} rows, the push has {}", n, order.n));
  return order;
}

}  // namespace rcb::service
