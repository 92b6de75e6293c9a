// Opening a scene, fetching its layout, and the public functions of Scene; the push is in step.cpp.
#include "client/lib/scene/scene.hpp"

#include <algorithm>
#include <utility>

#include <fmt/format.h>

#include "common/wire/field_reader.hpp"
#include "common/wire/limits.hpp"

namespace rcb::client {
namespace {

Status odd_answer(const std::string& what, const std::string& why) {
  return {Code::protocol_error, fmt::format("answer to '{}': {}", what, why),
          "use a client and a service of the same version"};
}

}  // namespace

Scene::Scene(std::unique_ptr<State> state) : state_(std::move(state)) {}
Scene::Scene(Scene&&) noexcept = default;
Scene& Scene::operator=(Scene&&) noexcept = default;
Scene::~Scene() = default;
std::optional<std::int64_t> Scene::last_step() const { return state_->last_step(); }
Result<StepResult> Scene::step(const Positions& positions, const StepOptions& options) {
  const auto moved = options.moved ? StepRequest::Moved::rows : StepRequest::Moved::all;
  return state_->step({positions, options, moved, {}});
}

Result<StepResult> Scene::step_unmoved(const StepOptions& options) {
  return state_->step({Positions{.dims = state_->dims()}, options, StepRequest::Moved::none, {}});
}

Result<StepResult> Scene::step_moved(std::span<const std::int64_t> ids, const Positions& positions,
                                     const StepOptions& options) {
  return state_->step({positions, options, StepRequest::Moved::ids, ids});
}

Result<std::span<double>> Scene::position_rows(std::size_t count) {
  return state_->arrays().rows<double>(count, state_->dims());
}

Result<std::vector<std::span<double>>> Scene::position_axes(std::size_t count) {
  return state_->arrays().axes<double>(count, state_->dims());
}

Result<std::span<float>> Scene::position_rows_f4(std::size_t count) {
  return state_->arrays().rows<float>(count, state_->dims());
}

Result<std::vector<std::span<float>>> Scene::position_axes_f4(std::size_t count) {
  return state_->arrays().axes<float>(count, state_->dims());
}

Result<cuts::Cuts> Scene::cuts(double deadline_seconds) { return state_->current_cuts(deadline_seconds); }

Scene::State::State(std::shared_ptr<Client::State> client, std::string name)
    : client_(std::move(client)), name_(std::move(name)), scene_(client_->known(name_)), run_(client_->run_of(name_)) {
  client_->scenes.insert(name_);
}

void Scene::State::forget_if_replaced() {
  const std::uint64_t run = client_->run_of(name_);
  if (std::exchange(run_, run) == run) return;
  replaced_ = true;
  scene_ = client_->known(name_);
  dims_ = scene_.dims.value_or(dims_);
  pushed_ = has_ids_ = has_weights_ = false;
  count_ = epoch_ = 0;
  last_step_.reset();
  unanswered_ = {};
  plan_.reset();
  forget_rows();
  cuts_.known.reset();
  weights_.clear();
  when_needed_ = false;
  began_ = answered_ = told_ = missed_ = base_unknown_ = false;
}

void Scene::State::forget_rows() {
  ids_.clear();
  rows_assumed_ = false;
  parts_.clear();
  known_.reset();
  counted_.forget();
}

Result<cuts::Cuts> Scene::State::current_cuts(double deadline_seconds) {
  forget_if_replaced();
  return cuts_.current(epoch_, session(), name_, deadline_seconds, [this](const Retry& retry) { return hold(retry); });
}

Result<Scene> Client::open_scene(const std::string& name) {
  if (Status status = wire::check_scene_name(name); !status) return status;
  if (Status status = State::refuse_both(state_->seats, "MemberScene", name); !status) return status;
  auto state = std::make_unique<Scene::State>(state_, name);
  Retry retry(wire::kDeadlineSecondsDefault);
  if (Status status = state->open(retry); !status) return status;
  return Scene(std::move(state));
}

Scene::State::~State() {
  // Another Scene of the same client may have it open, too.
  client_->scenes.erase(client_->scenes.find(name_));
  const bool last = !client_->scenes.contains(name_);
  // On a connection that is gone nothing is open.
  if (!session().connected() || generation_ != session().generation()) return;
  arrays_.unshare(session(), Deadline(kCloseSeconds));
  if (last && session().connected())
    static_cast<void>(session().call_once({{"command", "scene.close"}, {"scene", name_}}, Retry(kCloseSeconds)));
}

Status Scene::State::open(Retry& retry) {
  return session().retry_until_deadline(retry, [&] { return hold(retry); });
}

Result<Scene::State::Description> Scene::State::read_description(const wire::Json& json) {
  wire::FieldReader fields(json);
  Description found;
  found.dims = static_cast<int>(fields.integer("dims", 1, 3));
  found.parts = static_cast<int>(fields.integer("parts", 1, wire::kPartsMax));
  found.count = fields.particles("n");
  found.epoch = static_cast<std::uint64_t>(fields.integer_or("epoch", 0, kLarge, 0));
  if (fields.has("step")) found.step = fields.integer("step", 0, wire::kStepMax);
  found.ids = fields.flag("ids");
  found.weights = fields.flag("weights");
  if (fields.has("filled")) found.filled = fields.flag("filled");
  if (json.contains("positions_step"))
    found.older =
        found.step != (fields.has("positions_step") ? std::optional(fields.integer("positions_step", 0, wire::kStepMax))
                                                    : std::nullopt);
  found.when_needed = fields.text_or("positions", 16, "every-step") == "when-needed";
  found.incarnation = fields.text_or("incarnation", 16, "");
  if (!fields.ok()) return odd_answer("scene.open", fields.status().message());
  return found;
}

Status Scene::State::hold(const Retry& retry) {
  if (held()) return {};
  const auto json = described(session(), {{"command", "scene.open"}, {"scene", name_}}, retry);
  const std::string lost = fmt::format("the connection to {} was lost, and now", session().endpoint());
  const std::string advice = "create the scene and push it from its first step";
  if (json.status().code() == Code::not_found && pushed_)
    return {Code::not_found, fmt::format("{} it has no scene '{}'", lost, name_), advice};
  if (!json) return json.status();
  const auto found = read_description(*json);
  if (!found) return found.status();
  const bool same = found->incarnation == incarnation_;
  if (pushed_ && !(same && found->step && (found->count == count_ || found->count == count_if_committed_)))
    return {Code::not_found,
            !same         ? fmt::format("{} scene '{}' is another one, made anew", lost, name_)
            : found->step ? fmt::format("{} scene '{}' holds {} particles, not {}", lost, name_, found->count, count_)
                          : fmt::format("{} scene '{}' is empty", lost, name_),
            advice};
  generation_ = session().generation();
  replaced_ = false;
  parts_count_ = found->parts;
  dims_ = found->dims;
  when_needed_ = found->when_needed;
  incarnation_ = found->incarnation;
  filled_ = found->filled || !found->step;
  older_ = found->older;
  if (when_needed_) cuts_.wanted = true;
  if (!pushed_) {
    count_ = found->count;
    epoch_ = found->epoch;
    pushed_ = found->step.has_value();
    last_step_ = found->step;
    has_ids_ = found->ids;
    has_weights_ = found->weights;
    return {};
  }
  // Counts a step whose answer was lost, too.
  missed_ = missed_ || found->step != last_step_;
  base_unknown_ = base_unknown_ || (found->step != last_step_ && found->step != unanswered_.number());
  last_step_ = found->step;
  return {};
}

Result<Frame> Scene::State::ask_plan(const Retry& retry) const {
  return session().call_once({{"command", "plan"}, {"scene", name_}}, retry);
}

Status Scene::State::fetch_plan(std::span<const std::int64_t> ids, const Retry& retry) {
  const auto answer = ask_plan(retry);
  return answer ? take_plan(*answer, ids) : answer.status();
}

Status Scene::State::take_plan(const Frame& answer, std::span<const std::int64_t> ids) {
  const auto json = answer.json();
  if (!json) return json.status();
  const auto slot_ids = answer.array<std::int64_t>("id");
  const auto slot_parts = answer.array<std::int32_t>("part");
  const auto parts = wire::integer_field_or(*json, "parts", 1, wire::kPartsMax, parts_count_);
  if (!slot_ids || !slot_parts || slot_ids->size() != slot_parts->size() || !parts)
    return odd_answer("plan", "its arrays or parts are not as the protocol says");
  const auto counts = wire::numbers_field_or_empty(*json, "counts", 1U << 20U);
  const auto named = json->find("plan");
  if (!counts || counts->size() != static_cast<std::size_t>(session().ranks()) || named == json->end())
    return odd_answer("plan", fmt::format("'counts' must have {} entries", session().ranks()));
  std::vector<std::uint64_t> rank_counts;
  for (const double count : *counts) {
    if (!(count >= 0 && count <= static_cast<double>(wire::kParticlesMax)))
      return odd_answer("plan", "a negative count");
    rank_counts.push_back(static_cast<std::uint64_t>(count));
  }
  const auto version = wire::integer_field(*named, "version", 0, kLarge);
  const auto checksum_text = wire::string_field(*named, "checksum", 16);
  if (!version || !checksum_text) return odd_answer("plan", "no version or checksum");
  if (!has_ids_ &&
      std::ranges::any_of(ids, [&](std::int64_t id) { return id < 0 || std::uint64_t(id) >= slot_ids->size(); }))
    return wrong("the push gives ids, and the scene's particles have none but the numbers of their rows",
                 "leave the ids out (of a file: its column \"id\"), or make the scene anew");
  std::vector<std::int64_t> sorted;  // if the caller gave no ids, rows are in ascending id
  if (has_ids_ && ids.empty()) {
    sorted.assign(slot_ids->begin(), slot_ids->end());
    std::sort(sorted.begin(), sorted.end());
    ids = sorted;
  }
  auto plan = layout::Layout::full(rank_counts, *slot_ids, ids, static_cast<std::uint64_t>(*version));
  if (!plan) return plan.status();
  if (wire::hex64(plan->checksum()) != *checksum_text)
    return odd_answer(
        "plan", fmt::format("its checksum is {}, its ids give {}", *checksum_text, wire::hex64(plan->checksum())));
  std::vector<std::int32_t> by_row(slot_ids->size());
  std::size_t next = 0;
  for (int rank = 0; rank < plan->ranks(); ++rank)
    for (const std::uint64_t row : plan->rows(rank)) by_row[row] = (*slot_parts)[next++];
  if (!known_) known_ = std::move(parts_);
  parts_ = std::move(by_row);
  parts_count_ = static_cast<int>(*parts);
  plan_ = std::move(*plan);
  if (ids.data() != ids_.data()) {
    ids_.assign(ids.begin(), ids.end());
    rows_assumed_ = !sorted.empty();
  }
  return {};
}

}  // namespace rcb::client
