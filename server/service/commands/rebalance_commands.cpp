// Repartitions on request, without axis hysteresis; or only tells what that would do (dry run).
#include <limits>

#include <fmt/format.h>

#include "common/layout/layout.hpp"
#include "common/partition/partition.hpp"
#include "common/partition/quality/quality.hpp"
#include "common/wire/field_reader.hpp"
#include "common/wire/limits.hpp"
#include "server/service/commands/quality_json.hpp"
#include "server/service/context/collective.hpp"
#include "server/service/context/context.hpp"
#include "server/service/step/exchange.hpp"
#include "server/service/step/step.hpp"

namespace rcb::service {
namespace {

struct RebalanceRequest {
  SceneOptions options;  // the scene's, with the request's changes
  bool dry_run = false;
};

Result<RebalanceRequest> read_request(const wire::Json& request, const Scene& scene) {
  RebalanceRequest wanted{scene.options, false};
  wire::FieldReader fields(request);
  const int parts = static_cast<int>(fields.integer_or("parts", 1, wire::kPartsMax, scene.options.parts));
  wanted.options.tolerance =
      fields.number_or("tolerance", 0, std::numeric_limits<double>::infinity(), scene.options.tolerance, true);
  wanted.dry_run = fields.flag("dry_run");
  // Only the coordinator knows whether others have the scene open: without "force" it has refused the request then.
  // Here only the field's type is checked.
  fields.flag("force");
  if (!fields.ok()) return fields.status();
  const auto method = read_method(request, scene.options.dims, scene.options.method);
  if (!method.ok()) return method.status();
  if (parts != scene.options.parts && !scene.options.part_sizes.empty())
    return Status(Code::invalid_argument,
                  fmt::format("scene '{}' has sizes for {} parts", scene.name, scene.options.parts),
                  "the number of parts can't change while part sizes are given");
  wanted.options.parts = parts;
  wanted.options.method = method.value();
  return wanted;
}

std::uint64_t count_differences(std::span<const std::int32_t> a, std::span<const std::int32_t> b) {
  RCB_CHECK(a.size() == b.size(), "assignments of different length");
  std::uint64_t count = 0;
  for (std::size_t i = 0; i < a.size(); ++i) count += static_cast<std::uint64_t>(a[i] != b[i]);
  return count;
}

// Number of particles that the new parts would put on another rank. Collective.
std::uint64_t count_migrated(comm::Comm& comm, std::span<const std::int32_t> part, int parts) {
  const layout::PartRange own = layout::parts_of_rank(comm.rank(), parts, comm.size());
  std::uint64_t leaving = 0;
  for (const std::int32_t p : part) leaving += own.has(p) ? 0U : 1U;
  comm.all_sum({&leaving, 1});
  return leaving;
}

Response rebalance(Context& context, Scene& scene, const wire::Json& request) {
  const auto wanted = read_request(request, scene);
  if (!wanted.ok()) return failed(wanted.status());
  const SceneOptions& options = wanted->options;
  if (Status status = check_parts_total(context.scenes, scene.name, options.parts); !status.ok())
    return failed(std::move(status));
  const double start = context.clock.seconds();

  if (Status status = context.check_time(); !status.ok()) return failed(std::move(status));
  Status room = agree_room_to_partition(context.comm, scene.particles.count(), options.parts);
  if (!room.ok()) return failed(std::move(room));
  Status time;
  auto found =
      partition::partition(context.comm, scene.particles.view(), search_options(options), while_in_time(context, time));
  if (!time.ok()) return failed(std::move(time));
  RCB_CHECK(found.ok(), found.status().message());
  auto loads = partition::summarise_loads(context.comm, scene.particles.view(), found->part.span(), options.part_sizes,
                                          options.parts);
  std::uint64_t moved = count_differences(scene.part.span(), found->part.span());
  context.comm.all_sum({&moved, 1});
  const std::uint64_t migrated = count_migrated(context.comm, found->part.span(), options.parts);

  wire::Json json{{"scene", scene.name},
                  {"method", cuts::method_name(options.method)},
                  {"parts", options.parts},
                  {"error_before", scene.loads->error},
                  {"error", loads.error},
                  {"imbalance", loads.imbalance},
                  {"moved", moved},
                  {"migrated", migrated},
                  {"axes_flipped", cuts::axes_flipped(*scene.tree, found->tree)},
                  {"adopted", !wanted->dry_run},
                  {"reason", wanted->dry_run ? "dry run: nothing was changed" : "asked for"},
                  {"hash", wire::hex64(found->tree.hash())}};
  time = context.check_time();
  // Other scenes may have got parts meanwhile.
  if (time.ok()) time = check_parts_total(context.scenes, scene.name, options.parts);
  if (!time.ok()) return failed(std::move(time));
  Response response = done(std::move(json));
  if (wanted->dry_run) {
    const auto quality = partition::quality(context.comm, scene.particles.view(), found->part.span(), options.parts,
                                            &found->tree, std::nullopt, while_in_time(context, time));
    if (!quality) return failed(std::move(time));
    put_quality(response, response.json["quality"], *quality);
  } else {
    scene.options = options;
    scene.part = std::move(found->part);
    adopt(scene, {std::move(found->tree), found->cost.rounds, found->cost.reductions}, std::move(loads));
    send_strangers(context.comm, scene, false);
    if (context.root()) response.change = {scene.name, scene::Rebalanced{options, scene}};
  }
  response.json["epoch"] = scene.epoch;
  response.json["seconds"] = context.clock.seconds() - start;
  return response;
}

constexpr Command kRebalanceCommands[] = {{"rebalance", rebalance, Needs::positions}};

}  // namespace

std::span<const Command> rebalance_commands() { return kRebalanceCommands; }

}  // namespace rcb::service
