// The push: all ranks prepare it, then all commit it or all give it up.
#include <algorithm>

#include <fmt/format.h>
#include <malloc.h>

#include "common/layout/layout.hpp"
#include "server/service/commands/cuts_json.hpp"
#include "server/service/step/step.hpp"

namespace rcb::service {
namespace {

wire::Json plan_json(const Scene& scene) {
  return {{"version", scene.plan_version}, {"checksum", wire::hex64(scene.plan_checksum)}};
}

Response answer(const Scene& scene, const StepReport& report, const PushRequest& push, PartChanges changes,
                Buffer<std::int32_t> inserted_part, std::optional<std::int64_t> previous_step) {
  Response response = done({{"report", to_json(report)},
                            {"previous_step", previous_step ? wire::Json(*previous_step) : wire::Json(nullptr)},
                            {"plan", plan_json(scene)}});
  if (!push.changes) return response;
  if (!inserted_part.empty() || push.inserted > 0) {
    const std::uint64_t inserted = inserted_part.size();
    response.arrays.push_back(make_array("inserted_part", "<i4", inserted, inserted_part.release_as<std::byte>()));
  }
  const std::uint64_t count = changes.id.size();
  response.arrays.push_back(make_array("changed_id", "<i8", count, changes.id.release_as<std::byte>()));
  response.arrays.push_back(make_array("changed_part", "<i4", count, changes.part.release_as<std::byte>()));
  return response;
}

// Returns memory to the system that only a full change needs. Under a sanitizer the C library's allocator is unused,
// and sets itself up at its first call, which ranks that are threads must not make at once.
void return_freed_memory() {
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
  ::malloc_trim(0);
#endif
}

Response push(Context& context, Scene& scene, const wire::Json& request) {
  const auto push = read_order(request, context.comm.size());
  if (!push.ok()) return failed(push.status());
  auto staged = prepare(context, scene, push.value());
  if (!staged.ok()) return failed(staged.status());
  if (push->refill) return refill(context, scene, *staged, push.value());
  PartChanges changes;
  const std::optional<std::int64_t> previous_step = scene.step;
  scene::Stepped stepped = commit(context, scene, *staged, push.value(), push->changes ? &changes : nullptr);
  const StepReport& report = stepped.report;
  give_back(context, scene, push.value(), *staged);
  if (!previous_step || layout::is_full_change(report.migrated, report.n)) {
    staged->scan = {};
    return_freed_memory();
  }
  if (!context.root()) return {};  // only rank 0's response is used
  Response response =
      answer(scene, report, push.value(), std::move(changes), std::move(staged->edits.inserted_part), previous_step);
  put_cuts_unless_known(context, response, scene, push.value());
  response.change = {scene.name, std::move(stepped)};
  return response;
}

constexpr Command kPushCommands[] = {{"push", push, Needs::scene}};

}  // namespace

std::span<const Command> push_commands() { return kPushCommands; }

}  // namespace rcb::service
