#include "server/service/service.hpp"

#include <algorithm>
#include <utility>

#include <fmt/format.h>

#include "common/layout/layout.hpp"
#include "server/api/commands.hpp"
#include "server/service/context/context.hpp"
#include "server/service/push/staging.hpp"

namespace rcb::service {
namespace {

constexpr std::uint64_t kFileBytesMax = std::uint64_t{1} << 30U;  // each command that uses files has a limit of its own

}  // namespace

struct Service::State {
  comm::Comm& comm;
  const Clock& clock;
  ServiceOptions options;
  std::map<std::string, Scene> scenes = {};
  std::map<std::string, Command> commands = {};
  SideThread files{kFileBytesMax, options.start_thread};
  Response call(const Command& command, const wire::Json& request, Context& context) {
    if (command.run != nullptr) return command.run(context, request);
    const auto scene = find_scene(context, request, command.needs);
    return scene.ok() ? command.run_on(context, **scene, request) : failed(scene.status());
  }
};

Service::Service(comm::Comm& comm, const Clock& clock, ServiceOptions options)
    : state_(new State{comm, clock, std::move(options)}) {
  for (const auto table : {scene_commands(), push_commands(), query_commands(), quality_commands(), halo_commands(),
                           rebalance_commands(), file_commands()})
    for (const Command& command : table) state_->commands.emplace(command.name, command);
}

Service::~Service() = default;

Response Service::execute(const wire::Json& request, std::vector<PushSlice> slices, const OrderTerms& terms) {
  const auto name = wire::string_field(request, "command", 64);
  if (!name.ok()) return failed(name.status());
  const auto command = state_->commands.find(name.value());
  if (command == state_->commands.end())
    return failed({Code::unsupported, fmt::format("unknown command '{}'", name.value()),
                   "the service may be older than the client: see 'status' for its version"});
  Context context{state_->comm,  state_->clock,     state_->options, state_->scenes,
                  state_->files, std::move(slices), terms,           state_->clock.seconds()};
  // Before any work: it may have stood in the queue for long.
  if (command->second.computes)
    if (Status status = context.check_time(); !status.ok()) return failed(std::move(status));
  Response response = state_->call(command->second, request, context);
  if (!context.root()) return {};
  if (!response.status.ok()) return response;
  if (command->second.needs == Needs::positions)
    response.json["positions_step"] = *state_->scenes.at(request.at("scene").get<std::string>()).step;
  if (command->second.computes)
    response.change = {request.at("scene").get<std::string>(), scene::Asked{command->first}};
  return response;
}

namespace {

Status given_up(Code why) {
  if (why == Code::deadline_exceeded)
    return {why, "the command was given up at its deadline", "give it a longer deadline"};
  if (why == Code::aborted)
    return {why, "the command was given up: its client has gone, or the service is shutting down"};
  return {};
}

}  // namespace

Status Context::check_time_here() const {
  if (terms.cancelled && *terms.cancelled) return given_up(Code::aborted);
  return given_up(clock.seconds() - begun > terms.seconds_left ? Code::deadline_exceeded : Code::ok);
}

Status Context::check_time() {
  struct {
    Code verdict = Code::ok;
    std::uint64_t newest_waiting = 0;
  } word;
  if (root()) {
    word.verdict = check_time_here().code();
    if (terms.waiting != nullptr) word.newest_waiting = terms.waiting->newest();
  }
  comm.broadcast(std::as_writable_bytes(std::span(&word, 1)), 0);
  if (terms.waiting != nullptr) terms.waiting->execute(word.newest_waiting);
  return given_up(word.verdict);
}

Result<Scene*> find_scene(Context& context, const wire::Json& request, Needs needs) {
  const auto name = wire::string_field(request, "scene", 256);
  if (!name.ok()) return name.status();
  const auto found = context.scenes.find(name.value());
  if (found == context.scenes.end())
    return Status(Code::not_found, fmt::format("no scene '{}'", name.value()),
                  "'rcbctl scene list' names those that are there");
  const Scene& scene = found->second;
  if (needs == Needs::positions && !scene.step && scene.epoch > 0)
    return Status(Code::not_found,
                  fmt::format("the ranks hold no positions of scene '{}' since the service was started", name.value()),
                  "they come with the next step of its solver");
  if (needs == Needs::cuts ? scene.epoch == 0 : needs == Needs::positions && !scene.step)
    return Status(Code::not_found, fmt::format("scene '{}' has no positions yet", name.value()), "push a step first");
  return &found->second;
}

}  // namespace rcb::service
