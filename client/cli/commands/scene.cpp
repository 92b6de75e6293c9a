// scene create, list, show, drop.
#include <fmt/format.h>

#include "client/cli/app.hpp"
#include "client/cli/print/output.hpp"

namespace rcb::cli {
namespace {

struct CreateOptions {
  std::string name;
  client::SceneOptions scene;
};

void print_scene(const Json& scene) {
  Facts facts;
  for (const auto& [field, title] :
       std::initializer_list<std::pair<const char*, const char*>>{{"scene", "scene"},
                                                                  {"n", "points"},
                                                                  {"dims", "dims"},
                                                                  {"parts", "parts"},
                                                                  {"ranks", "ranks"},
                                                                  {"method", "method"},
                                                                  {"tolerance", "tolerance"},
                                                                  {"axis_hysteresis", "axis hysteresis"},
                                                                  {"cut_tolerance", "cut tolerance"},
                                                                  {"policy", "policy"},
                                                                  {"part_sizes", "part sizes"},
                                                                  {"positions", "positions"},
                                                                  {"weights", "weights"},
                                                                  {"ids", "own ids"},
                                                                  {"step", "step"},
                                                                  {"positions_step", "positions of step"},
                                                                  {"epoch", "epoch"},
                                                                  {"error", "error"},
                                                                  {"imbalance", "imbalance"},
                                                                  {"hash", "hash"}})
    if (scene.contains(field)) facts.add(title, text_of(scene, field));
  facts.add("open by", holders_text(scene));
  facts.print();
}

Status create(const CreateOptions& options, const Context& context) {
  const client::SceneOptions& scene = options.scene;
  Json arguments{{"scene", options.name},
                 {"parts", scene.parts},
                 {"dims", scene.dims},
                 {"method", scene.method},
                 {"tolerance", tolerance_json(scene.tolerance)},
                 {"axis_hysteresis", scene.axis_hysteresis},
                 {"cut_tolerance", scene.cut_tolerance},
                 {"policy", scene.policy},
                 {"positions", scene.positions},
                 {"replace", scene.replace}};
  if (!scene.part_sizes.empty()) arguments["part_sizes"] = scene.part_sizes;
  return ask_and_show(context, "scene.create", arguments, [&](const Json&) {
    print_line(fmt::format("created {}: {} parts, {} dims", options.name, scene.parts, scene.dims));
  });
}

Status drop(const std::string& name, const Context& context) {
  auto client = connect(context);
  if (!client) return client.status();
  if (Status status = client->drop_scene(name); !status) return status;
  return show(context, {{"scene", name}, {"dropped", true}}, [&] { print_line("dropped " + name); });
}

}  // namespace

void add_scene_commands(CLI::App& app, Context& context) {
  CLI::App* scene = app.add_subcommand("scene", "Named particle sets: create, list, show, drop");
  scene->fallthrough();
  scene->group(kSceneGroup);
  scene->require_subcommand(1);
  scene->footer("Examples:\n  rcbctl scene create jet --parts 8\n  rcbctl scene list\n");

  auto [creation, options] =
      add_command(*scene, context,
                  {"create", "Makes a scene",
                   "  rcbctl scene create jet --parts 8\n"
                   "  rcbctl scene create jet --parts 3 --part-sizes 1,2,3 --tolerance inf --replace"},
                  create);
  client::SceneOptions& made = options.scene;
  add_value(creation, "NAME", options.name, kind::text("NAME"), "1 to 64 of letters, digits, . _ -")->required();
  add_value(creation, "--parts", made.parts, kind::part_count(), "number of parts")->required();
  add_value(creation, "--dims", made.dims, kind::dimensions(), "1, 2 or 3 dimensions")->capture_default_str();
  add_scene_options(creation, made);

  add_command(*scene, context, {"list", "All scenes", "  rcbctl scene list --json"}, [&context] {
    return ask_and_show(context, "scene.list", Json::object(),
                        [](const Json& reply) { print_scenes(reply.at("scenes")); });
  });

  auto name = std::make_shared<std::string>();
  CLI::App* command =
      add_command(*scene, context, {"show", "The options of a scene, and how it stands", "  rcbctl scene show jet"},
                  [name, &context] {
                    return ask_and_show(context, "scene.show", {{"scene", *name}}, print_scene);
                  });
  add_scene_name(*command, *name);
  auto [drops, dropped] = add_command(*scene, context, {"drop", "Forgets a scene", "  rcbctl scene drop jet"}, drop);
  add_scene_name(drops, dropped);
}

}  // namespace rcb::cli
