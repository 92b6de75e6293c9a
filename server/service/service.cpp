#include "server/service/service.hpp"

#include <utility>

#include <fmt/format.h>

#include "common/io/roots.hpp"
#include "common/plan/plan.hpp"
#include "server/api/commands.hpp"
#include "server/service/context.hpp"
#include "server/service/staging.hpp"

namespace rcb::service {

struct Service::State {
  partition::Comm& comm;
  const Clock& clock;
  Loans* loans;
  std::map<std::string, Scene> scenes;
  NoSkip no_skip;
  std::map<std::string, Command> commands;
  const io::Roots* roots;
  std::vector<Spare> spares = {};
  // A scene's particles by rank, as of this (epoch, step, plan version).
  struct RankCounts {
    std::uint64_t epoch = 0;
    std::optional<std::int64_t> step;
    std::uint64_t plan_version = 0;
    std::vector<std::uint64_t> counts;
  };
  std::map<std::string, RankCounts> rank_counts = {};

  const std::vector<std::uint64_t>& counts_of(const std::string& name, const Scene& scene) {
    RankCounts& known = rank_counts[name];
    if (known.counts.empty() || known.epoch != scene.epoch || known.step != scene.step ||
        known.plan_version != scene.plan_version) {
      known = {scene.epoch, scene.step, scene.plan_version, {}};
      for (int r = 0; r < comm.size(); ++r) known.counts.push_back(held_by(scene, scene.n, r, comm.size()));
    }
    return known.counts;
  }

  // What the scene lends is taken back for the time of an order that may change it.
  Response run(const Command& command, const wire::Json& request, Context& context) {
    const api::CommandInfo* known = api::find_command(command.name);
    const bool reads = known != nullptr && known->effect == api::Effect::reads;
    if (loans == nullptr || reads) return command.run(context, request);
    const auto name = wire::string_field(request, "scene", 256);
    if (name.ok())
      context.loan = loans->take_back(*name);
    else
      loans->take_back_all();
    Response response = command.run(context, request);
    const auto scene = name.ok() ? scenes.find(*name) : scenes.end();
    if (scene == scenes.end() || !scene->second.pushed) return response;
    refresh_regions(scene->second, comm.rank(), comm.size());
    loans->lend(scene->second);
    return response;
  }
};

Service::Service(partition::Comm& comm, const Clock& clock, NoSkip no_skip, Loans* loans, const io::Roots* roots)
    : state_(new State{comm, clock, loans, {}, no_skip, {}, roots}) {
  for (const auto table : {scene_commands(), push_commands(), member_commands(), query_commands(), quality_commands(),
                           rebalance_commands(), file_commands()})
    for (const Command& command : table) state_->commands.emplace(command.name, command);
}

Service::~Service() {
  if (state_->loans != nullptr) state_->loans->take_back_all();
}

namespace {

// Counts a question that was answered from the particles. Local.
void note_question(Context& context, const wire::Json& request, const std::string& name) {
  const auto scene = find_scene(context, request);
  if (!scene.ok()) return;
  ++scene.value()->totals.asked[name];
  scene.value()->asked = true;
}

}  // namespace

Response Service::execute(const wire::Json& request, std::vector<PushSlice> slices, const OrderTerms& terms) {
  const auto name = wire::string_field(request, "command", 64);
  if (!name.ok()) return failed(name.status());
  const auto command = state_->commands.find(name.value());
  if (command == state_->commands.end())
    return failed({Code::unsupported, fmt::format("unknown command '{}'", name.value()),
                   "the service may be older than the client: see 'status' for its version"});
  static const io::Roots kNowhere;
  Context context{state_->comm,
                  state_->clock,
                  state_->scenes,
                  std::move(slices),
                  terms.received_seconds,
                  state_->spares,
                  state_->no_skip,
                  state_->roots == nullptr ? kNowhere : *state_->roots,
                  nullptr};
  Response response = state_->run(command->second, request, context);
  if (command->second.computes && response.status.ok()) note_question(context, request, command->first);
  if (!context.root()) return {};
  return response;
}

std::vector<Spare> Service::take_spares() { return std::exchange(state_->spares, {}); }

Snapshot Service::snapshot() const {
  Snapshot snapshot;
  for (const auto& [name, scene] : state_->scenes) {
    SceneSummary& summary = snapshot.scenes[name];
    summary = {.name = name,
               .n = scene.n,
               .dims = scene.options.dims,
               .parts = scene.options.parts,
               .weights = scene.particles.has_weights,
               .ids = scene.ids,
               .step = scene.step,
               .step_session = scene.recent_steps.empty() ? "" : scene.recent_steps.back().second,
               .epoch = scene.epoch,
               .plan_version = scene.plan_version,
               .plan_checksum = scene.plan_checksum,
               .rank_counts = state_->counts_of(name, scene)};
    if (scene.pushed) {
      summary.error = scene.loads.error;
      summary.imbalance = scene.loads.imbalance;
      summary.mean_step_seconds =
          scene.totals.seconds.total / static_cast<double>(std::max<std::uint64_t>(1, scene.totals.steps));
    }
    snapshot.steps += scene.totals.steps;
  }
  std::erase_if(state_->rank_counts, [&](const auto& entry) { return !snapshot.scenes.contains(entry.first); });
  return snapshot;
}

Result<Scene*> find_scene(Context& context, const wire::Json& request) {
  const auto name = wire::string_field(request, "scene", 256);
  if (!name.ok()) return name.status();
  const auto found = context.scenes.find(name.value());
  if (found == context.scenes.end())
    return Status(Code::not_found, fmt::format("no scene '{}'", name.value()),
                  "'rcbctl scene list' names those that are there");
  return &found->second;
}

Result<Scene*> find_pushed_scene(Context& context, const wire::Json& request) {
  auto scene = find_scene(context, request);
  if (scene.ok() && !scene.value()->pushed)
    return Status(Code::not_found, fmt::format("scene '{}' has no positions yet", scene.value()->name),
                  "push a step first");
  return scene;
}

wire::Array make_array(std::string name, std::string dtype, std::uint64_t count, Buffer<std::byte> bytes) {
  return {std::move(name), std::move(dtype), {count}, std::move(bytes)};
}

}  // namespace rcb::service
