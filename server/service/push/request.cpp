#include "server/service/push/request.hpp"

#include <utility>

#include <fmt/format.h>

#include "common/wire/field_reader.hpp"
#include "common/wire/limits.hpp"
#include "server/scene/ledger.hpp"

namespace rcb::service {
namespace {

Status check_changes(const Scene& scene, const api::Push& push) {
  if (push.moved != Moved::all && !push.base_step)
    return {Code::invalid_argument, "a push of few particles names no 'base_step'",
            "name the step that the others' positions are those of"};
  if (push.base_step && scene.step != push.base_step)
    return {Code::base_lost,
            scene.step ? fmt::format("the push builds on step {}, the last step of scene '{}' is {}", *push.base_step,
                                     scene.name, *scene.step)
                       : fmt::format("the push builds on step {}, scene '{}' has no positions yet", *push.base_step,
                                     scene.name),
            "push all particles"};
  if (!scene.pushed && push.edits())
    return {Code::invalid_argument,
            fmt::format("scene '{}' has no particles yet to insert others beside or to remove", scene.name),
            "push a first step with all of them"};
  if (push.moved != Moved::all && push.weights)
    return {Code::invalid_argument, "weights are replaced all together", "push all particles with their weights"};
  if (push.removed > scene.n)
    return {Code::invalid_argument,
            fmt::format("{} particles are to be removed, scene '{}' has {}", push.removed, scene.name, scene.n)};
  if (scene.n + push.inserted - push.removed > static_cast<std::uint64_t>(wire::kParticlesMax))
    return {Code::too_large,
            fmt::format("scene '{}' would have more than {} particles", scene.name, wire::kParticlesMax)};
  return {};
}

}  // namespace

Result<PushRequest> read_order(const wire::Json& request, int ranks) {
  wire::FieldReader fields(request);
  api::PushId id{.scene = fields.text("scene", 64), .session = fields.text("session", 64)};
  id.step = fields.integer("step", 0, wire::kStepMax);
  if (!fields.ok()) return fields.status();
  auto push = api::read_push(request, std::move(id), ranks);
  if (!push.ok()) return push.status();
  PushRequest order{std::move(*push), request.contains("staged"), {}, {}};
  if (const auto terms = request.find("terms"); terms != request.end()) order.terms = scene::read_terms(*terms);
  return order;
}

// A push that brings the particles of the last step to ranks that were started anew.
static Status check_refill(const Scene& scene, const PushRequest& push) {
  if (scene.pushed || scene.epoch == 0)
    return {Code::invalid_argument, fmt::format("scene '{}' lacks no particles", scene.name), "push a step"};
  const auto with = [](bool there) { return there ? "with" : "without"; };
  const bool ids = push.ids || push.members() > 0 || push.n == 0 || !scene.ids;
  if (push.n != scene.n || push.weights != scene.particles.has_weights || !ids)
    return {Code::invalid_argument,
            fmt::format("{} particles {} weights, {} ids are brought, scene '{}' has {} {} weights, {} ids", push.n,
                        with(push.weights), with(push.ids), scene.name, scene.n, with(scene.particles.has_weights),
                        with(scene.ids)),
            "bring all particles of the last step"};
  if (push.moved != Moved::all || push.edits() || (push.from_memory() && !push.by_id) ||
      (!push.by_id && push.plan.version != 0))
    return {Code::invalid_argument,
            "particles that the ranks lack are brought as in a first push: all, none inserted "
            "or removed, and from shared memory in order \"id\""};
  return {};
}

Status check_request(const Scene& scene, const PushRequest& push) {
  if (push.refill) return check_refill(scene, push);
  if (!scene.pushed && scene.epoch > 0)
    return {Code::base_lost,
            fmt::format("the ranks hold no particles of scene '{}' since the service was started", scene.name),
            "bring all of them first: push.begin with \"refill\""};
  if (scene.step && push.id.step <= *scene.step) return scene::stale_step(scene.name, push.id.step, *scene.step);
  if (scene.pushed && push.n != scene.n)
    return {Code::invalid_argument, fmt::format("{} particles pushed, scene '{}' has {}", push.n, scene.name, scene.n),
            "push all of the scene's particles, or create a scene anew with --replace"};
  if (Status status = check_changes(scene, push); !status.ok()) return status;
  if (scene.pushed && push.ids) return {Code::invalid_argument, "ids may come with a scene's first push alone"};
  if (scene.pushed && push.weights && !scene.particles.has_weights)
    return {Code::invalid_argument, fmt::format("scene '{}' has no weights", scene.name),
            "weights must be there from the first push on"};
  if (scene.pushed && !push.by_id && push.moved != Moved::none &&
      (push.plan.version != scene.plan_version || push.plan.checksum != scene.plan_checksum))
    return {
        Code::stale_plan,
        fmt::format("push has plan version {}, scene '{}' is at {}", push.plan.version, scene.name, scene.plan_version),
        "fetch the plan and push again"};
  if (!scene.pushed && !push.by_id && push.plan.version != 0)
    return {Code::stale_plan,
            fmt::format("push has plan version {}, but scene '{}' has no positions yet", push.plan.version, scene.name),
            "the first push goes by blocks of rows, plan version 0"};
  return {};
}

}  // namespace rcb::service
