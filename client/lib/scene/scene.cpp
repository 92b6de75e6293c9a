// Opening a scene, and the public functions of Scene.
#include "client/lib/scene/scene.hpp"

#include <algorithm>
#include <utility>

#include <fmt/format.h>

#include "common/wire/field_reader.hpp"
#include "common/wire/limits.hpp"

namespace rcb::client {

Scene::Scene(std::unique_ptr<State> state) : state_(std::move(state)) {}
Scene::Scene(Scene&&) noexcept = default;
Scene& Scene::operator=(Scene&&) noexcept = default;
Scene::~Scene() = default;
std::optional<std::int64_t> Scene::last_step() const { return state_->last_step(); }
Result<StepResult> Scene::step(const Positions& positions, const StepOptions& options) {
  return state_->step(positions, options);
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

std::shared_ptr<const void> Scene::position_memory() const { return state_->arrays().given(); }

Result<cuts::Cuts> Scene::cuts(double deadline_seconds) { return state_->current_cuts(deadline_seconds); }

Result<Scene> Client::open_scene(const std::string& name, const SeatOptions& options) {
  if (Status status = wire::check_scene_name(name); !status) return status;
  if (options.seats < 1 || options.seat < 0 || options.seat >= options.seats)
    return Status(Code::invalid_argument, fmt::format("seat {} of {}", options.seat, options.seats),
                  "seats count from 0, and there is at least one");
  // A connection opens a scene once, with a seat or for all particles: the end of either would end both.
  if (state_->seats.contains(name) || (options.seats > 1 && state_->scenes.contains(name)))
    return Status(Code::busy, fmt::format("this client has scene '{}' open, and a seat excludes others", name),
                  "open it with another client, or after that one has ended");
  auto state = std::make_unique<Scene::State>(state_, name, options);
  Retry retry(options.deadline_seconds);
  if (Status status = state->open(retry); !status) return status;
  return Scene(std::move(state));
}

Scene::State::State(std::shared_ptr<Client::State> client, std::string name, const SeatOptions& seat)
    : client_(std::move(client)), name_(std::move(name)), seat_(seat) {
  if (const auto made = client_->threads.find(name_); made != client_->threads.end()) threads_ = made->second;
  open_scenes().insert(name_);
}

Scene::State::~State() {
  // Another Scene of the same client may have it open, too.
  open_scenes().erase(open_scenes().find(name_));
  // On a connection that is gone nothing is open.
  if (!session().connected() || generation_ != session().generation()) return;
  arrays_.unshare(session(), Deadline(kCloseSeconds));
  if (!open_scenes().contains(name_) && session().connected()) close(Retry(kCloseSeconds));
}

void Scene::State::close(const Retry& retry) const {
  static_cast<void>(session().call_once({{"command", "scene.close"}, {"scene", name_}}, retry));
}

Result<cuts::Cuts> Scene::State::current_cuts(double deadline_seconds) {
  return cuts_.current(epoch_, session(), name_, deadline_seconds, [this](const Retry& retry) { return hold(retry); });
}

Status Scene::State::open(Retry& retry) {
  // The service may not have noticed yet that the connection which holds the seat was lost: our previous one, or that
  // of a process in whose place this one was started.
  const auto mend = [&](const Status& status) {
    return seated() && session().outlive() && status.code() == Code::busy &&
           session().wait(retry, status, status.message()).ok();
  };
  return session().retry_until_deadline(
      retry, [&] { return hold(retry); }, mend);
}

Result<Scene::State::Description> Scene::State::read_description(const wire::Json& json) const {
  wire::FieldReader fields(json);
  Description found;
  found.dims = static_cast<int>(fields.integer("dims", 1, 3));
  found.epoch = static_cast<std::uint64_t>(fields.integer_or("epoch", 0, kLarge, 0));
  if (fields.has("step")) found.step = fields.integer("step", 0, wire::kStepMax);
  found.ids = fields.flag("ids");
  found.weights = fields.flag("weights");
  found.filled = !found.step || !fields.has("filled") || fields.flag("filled");
  found.when_needed = fields.text_or("positions", 16, "every-step") == "when-needed";
  found.incarnation = fields.text_or("incarnation", 16, "");
  if (const auto claim = json.find("seat"); claim != json.end()) {
    const auto generation = wire::integer_field(*claim, "generation", 1, kLarge);
    fields.fail(generation.status());
    if (generation) found.generation = static_cast<std::uint64_t>(*generation);
  }
  if (fields.ok()) return found;
  return Status(Code::protocol_error, fmt::format("what is told of scene '{}': {}", name_, fields.status().message()),
                "use a client and a service of the same version");
}

Status Scene::State::hold(const Retry& retry) {
  if (generation_ == session().generation()) return {};
  wire::Json request{{"command", "scene.open"}, {"scene", name_}};
  // The service may not have noticed yet that the previous connection was lost: a higher generation displaces it. Where
  // an answer was lost, the seat may have the generation that was asked for last.
  const std::uint64_t asked_before = seat_asked_;
  if (seated()) request.update({{"seat", seat_.seat}, {"seats", seat_.seats}});
  if (seated() && seat_generation_ > 0)
    request["generation"] = seat_asked_ = std::max(seat_generation_, seat_asked_) + 1;
  const auto json = described(session(), std::move(request), retry);
  // Busy: another process has taken the seat. Higher and higher numbers would take it from that one.
  if (json.status().code() == Code::busy) seat_asked_ = asked_before;
  if (json.status().code() == Code::not_found && last_step_)
    return {Code::not_found,
            fmt::format("the connection to {} was lost, and now it has no scene '{}'", session().endpoint(), name_),
            "create the scene and push it from its first step"};
  if (!json) return json.status();
  const auto found = read_description(*json);
  if (!found) return found.status();
  if (seated() && found->generation == 0)
    return {Code::protocol_error, fmt::format("{} gave no seat of scene '{}'", session().endpoint(), name_),
            "use a client and a service of the same version"};
  if (generation_ != 0 && found->incarnation != incarnation_) {
    if (seated()) close(retry);  // the seat is for others
    return {Code::not_found,
            fmt::format("the connection to {} was lost, and now scene '{}' is another one, made anew",
                        session().endpoint(), name_),
            "open the scene again, and push it from its first step"};
  }
  generation_ = session().generation();
  seat_generation_ = found->generation;
  dims_ = found->dims;
  when_needed_ = found->when_needed;
  incarnation_ = found->incarnation;
  filled_ = found->filled;
  has_ids_ = found->ids;
  has_weights_ = found->weights;
  epoch_ = found->epoch;
  last_step_ = found->step;  // counts a step whose answer was lost, too
  return {};
}

Result<std::optional<std::int64_t>> Scene::State::step_in_force(const Retry& retry) const {
  const auto json = described(session(), {{"command", "scene.show"}, {"scene", name_}}, retry);
  if (!json) return json.status();
  const auto found = read_description(*json);
  if (!found) return found.status();
  return found->step;
}

}  // namespace rcb::client
