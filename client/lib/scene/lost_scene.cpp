#include "client/lib/scene/lost_scene.hpp"

#include <vector>

#include <fmt/format.h>

namespace rcb::client {

wire::Json scene_options(const wire::Json& description) {
  wire::Json options = wire::Json::object();
  for (const char* name : {"parts", "dims", "method", "tolerance", "axis_hysteresis", "cut_tolerance", "policy",
                           "positions", "part_sizes"})
    if (const auto field = description.find(name); field != description.end() && !field->is_null())
      options[name] = *field;
  return options;
}

Result<wire::Json> described(Session& session, wire::Json request, const Retry& retry) {
  const auto answer = session.call_once(std::move(request), retry);
  if (!answer) return answer.status();
  auto json = answer->json();
  if (!json) return json;
  if (const auto sizes = answer->array<double>("part_sizes"))
    (*json)["part_sizes"] = std::vector<double>(sizes->begin(), sizes->end());
  return json;
}

namespace {

// Tells the user if another client has meanwhile created the scene with other options.
void tell_differences(const Session& session, const std::string& scene, const wire::Json& opened, KnownScene& known) {
  const wire::Json found = scene_options(opened);
  std::string differences;
  for (const auto& [name, value] : found.items())
    if (const auto before = known.options.find(name); before != known.options.end() && *before != value)
      differences += fmt::format("{}{} {} instead of {}", differences.empty() ? "" : ", ", name,
                                 value.dump().substr(0, 80), before->dump().substr(0, 80));
  if (differences.empty()) return;
  session.notice(fmt::format("scene '{}' was made by somebody else, with {}; it is used as it is", scene, differences));
  known.options.update(found);
}

}  // namespace

Result<wire::Json> open_or_make_anew(Session& session, const wire::Json& arguments, KnownScene& known,
                                     const Retry& retry) {
  wire::Json open = arguments;
  open["command"] = "scene.open";
  auto opened = described(session, open, retry);
  const bool lost = known.options.is_object() && known.instance != session.instance() && session.outlive();
  if (!opened && opened.status().code() == Code::not_found && lost) {
    session.notice(fmt::format("{} was started again without scene '{}', which is made anew", session.endpoint(),
                               arguments.at("scene").get<std::string>()));
    wire::Json create = known.options;
    create["command"] = "scene.create";
    create["scene"] = arguments.at("scene");
    create["recreated"] = true;
    if (const auto made = session.call_once(std::move(create), retry);
        !made && made.status().code() != Code::already_exists)
      return made.status();
    opened = described(session, std::move(open), retry);
  }
  if (opened && lost) tell_differences(session, arguments.at("scene").get<std::string>(), *opened, known);
  if (opened) known.instance = session.instance();
  return opened;
}

void Client::State::begin_run(const std::string& scene, wire::Json options, int threads) {
  ++runs[scene];
  if (options.is_object())
    created[scene] = {std::move(options), session->instance(), threads};
  else
    created.erase(scene);
}

void refresh_options(Session& session, const std::string& scene, KnownScene& known, const Retry& retry) {
  if (!session.connected()) return;
  const auto shown = described(session, {{"command", "scene.show"}, {"scene", scene}}, retry);
  if (shown && shown->contains("parts")) known.options = scene_options(*shown);
}

}  // namespace rcb::client
