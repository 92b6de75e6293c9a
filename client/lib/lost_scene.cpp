#include "client/lib/lost_scene.hpp"

#include <fmt/format.h>

namespace rcb::client {

wire::Json scene_options(const wire::Json& description) {
  wire::Json options = wire::Json::object();
  for (const char* name :
       {"parts", "dims", "method", "tolerance", "axis_hysteresis", "cut_tolerance", "policy", "recut", "part_sizes"})
    if (const auto field = description.find(name); field != description.end() && !field->is_null())
      options[name] = *field;
  return options;
}

Result<wire::Json> open_or_make_anew(Session& session, const wire::Json& arguments, KnownScene& known,
                                     const Retry& retry) {
  wire::Json open = arguments;
  open["command"] = "scene.open";
  auto opened = session.ask_once(open, retry);
  const bool lost = known.options.is_object() && known.instance != session.instance() && session.outlive();
  if (!opened && opened.status().code() == Code::not_found && lost) {
    session.notice(fmt::format("{} was started again without scene '{}', which is made anew", session.endpoint(),
                               arguments.at("scene").get<std::string>()));
    wire::Json create = known.options;
    create["command"] = "scene.create";
    create["scene"] = arguments.at("scene");
    create["recreated"] = true;
    if (const auto made = session.ask_once(std::move(create), retry);
        !made && made.status().code() != Code::already_exists)
      return made.status();
    opened = session.ask_once(std::move(open), retry);
  }
  if (opened) known.instance = session.instance();
  return opened;
}

void refresh_options(Session& session, const std::string& scene, KnownScene& known, const Retry& retry) {
  if (!session.connected()) return;
  const auto shown = session.ask_once({{"command", "scene.show"}, {"scene", scene}}, retry);
  if (shown && shown->contains("parts")) known.options = scene_options(*shown);
}

}  // namespace rcb::client
