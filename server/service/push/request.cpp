#include "server/service/push/request.hpp"

#include <utility>

#include <fmt/format.h>

#include "common/wire/field_reader.hpp"
#include "common/wire/limits.hpp"
#include "server/scene/ledger.hpp"

namespace rcb::service {
namespace {

Result<Block> read_block(const wire::Json& json, int ranks) {
  wire::FieldReader fields(json);
  Block block;
  block.member = static_cast<int>(fields.integer_or("member", 0, wire::kSeatsMax, 0));
  block.n = fields.particles("n");
  block.way = api::read_path(fields);
  block.is_float32 = fields.word("dtype", {"<f8", "<f4"}) == "<f4";
  for (const double count : fields.numbers("counts", static_cast<std::size_t>(ranks)))
    block.counts.push_back(static_cast<std::uint64_t>(count));
  if (!fields.ok()) return fields.status();
  if (!block.counts.empty() && block.counts.size() != static_cast<std::size_t>(ranks))
    return Status(Code::invalid_argument, "a block's counts aren't those of all ranks");
  return block;
}

}  // namespace

Result<PushRequest> read_order(const wire::Json& request, int ranks) {
  wire::FieldReader fields(request);
  api::PushId id{.scene = fields.text("scene", 64), .session = fields.text("session", 64)};
  id.step = fields.integer("step", 0, wire::kStepMax);
  PushRequest order;
  order.members = static_cast<int>(fields.integer_or("members", 0, wire::kSeatsMax, 0));
  if (!fields.ok()) return fields.status();
  auto push = api::read_push(request, std::move(id), ranks);
  if (!push.ok()) return push.status();
  static_cast<api::Push&>(order) = std::move(*push);
  if (const auto terms = request.find("terms"); terms != request.end()) order.terms = scene::read_terms(*terms);
  order.way = scene::way_from_name(request.value("way", ""));
  const auto blocks = request.find("blocks");
  std::uint64_t n = 0;
  if (blocks != request.end() && blocks->is_array())
    for (const wire::Json& one : *blocks) {
      auto block = read_block(one, ranks);
      if (!block.ok()) return block.status();
      n += block->n;
      order.blocks.push_back(*block);
    }
  if (n != order.n)
    return Status(Code::invalid_argument, fmt::format("the blocks have {} rows, the push has {}", n, order.n));
  return order;
}

Status check_request(const Scene& scene, const PushRequest& push) {
  if (scene.step && push.id.step <= *scene.step) return scene::stale_step(scene.name, push.id.step, *scene.step);
  if (scene.epoch == 0) return {};
  Status conserved = api::check_conserved(scene.name, scene.n, push.n, push.inserted, push.removed);
  if (!conserved.ok() || push.n == 0 || scene.n == 0) return conserved;  // into an empty scene: as at a first push
  if ((push.inserted > 0 || push.removed > 0) && !push.ids)
    return {Code::invalid_argument, "particles come or go, and the push gives no ids",
            "without ids a row is its particle; give ids to all of them"};
  if (scene.ids && !push.ids)
    return {Code::invalid_argument, fmt::format("scene '{}' has ids, and the push gives none", scene.name),
            "give the id of each row"};
  if (push.weights != scene.particles.has_weights && (push.weights || !push.of_held(scene)))
    return {Code::invalid_argument,
            fmt::format("the push has {}weights, scene '{}' has {}", push.weights ? "" : "no ", scene.name,
                        push.weights ? "none" : "some"),
            "weights are there from the first push on, or never"};
  if (push.of_held(scene) && push.ids)
    return {Code::unsupported, "rows with ids can't be found by the particles that the ranks hold",
            "say in 'row' and 'counts' which rows each rank is to take"};
  return {};
}

}  // namespace rcb::service
