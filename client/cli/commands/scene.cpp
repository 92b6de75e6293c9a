// scene create, list, show, drop.
#include <fmt/format.h>

#include "client/cli/app.hpp"
#include "client/cli/print/output.hpp"

namespace rcb::cli {
namespace {

struct CreateOptions {
  std::string name;
  int parts = 0;
  int dims = 3;
  std::string method = "rcb";
  double tolerance = 0.1;
  double axis_hysteresis = 1.2;
  double cut_tolerance = 0;
  std::string policy = "tolerance";
  std::string recut = "all";
  std::vector<double> part_sizes;
  bool replace = false;
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
                                                                  {"recut", "recut"},
                                                                  {"part_sizes", "part sizes"},
                                                                  {"weights", "weights"},
                                                                  {"ids", "own ids"},
                                                                  {"step", "step"},
                                                                  {"epoch", "epoch"},
                                                                  {"error", "error"},
                                                                  {"imbalance", "imbalance"},
                                                                  {"hash", "hash"},
                                                                  {"members", "open by"}})
    if (scene.contains(field)) facts.add(title, text_of(scene, field));
  facts.print();
}

Status create(const CreateOptions& options, const Context& context) {
  auto client = connect(context);
  if (!client) return client.status();
  Json arguments{{"scene", options.name},
                 {"parts", options.parts},
                 {"dims", options.dims},
                 {"method", options.method},
                 {"tolerance", tolerance_json(options.tolerance)},
                 {"axis_hysteresis", options.axis_hysteresis},
                 {"cut_tolerance", options.cut_tolerance},
                 {"policy", options.policy},
                 {"recut", options.recut},
                 {"replace", options.replace}};
  if (!options.part_sizes.empty()) arguments["part_sizes"] = options.part_sizes;
  auto reply = ask(*client, "scene.create", arguments);
  if (!reply) return reply.status();
  return show(context, *reply, [&] {
    print_line(fmt::format("created {}: {} parts, {} dims", options.name, options.parts, options.dims));
  });
}

Status list(const Context& context) {
  auto client = connect(context);
  if (!client) return client.status();
  auto reply = ask(*client, "scene.list", Json::object());
  if (!reply) return reply.status();
  if (context.json) {
    print_json(*reply);
    return {};
  }
  print_scenes(reply->at("scenes"));
  return {};
}

Status show(const std::string& name, const Context& context) {
  auto client = connect(context);
  if (!client) return client.status();
  auto reply = ask(*client, "scene.show", {{"scene", name}});
  if (!reply) return reply.status();
  return show(context, *reply, [&] { print_scene(*reply); });
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

  auto options = std::make_shared<CreateOptions>();
  CLI::App* command = add_command(*scene, context,
                                  {"create", "Makes a scene",
                                   "  rcbctl scene create jet --parts 8\n"
                                   "  rcbctl scene create jet --parts 3 --part-sizes 1,2,3 --tolerance inf --replace"},
                                  [options, &context] { return create(*options, context); });
  add_value(*command, "NAME", options->name, kind::text("NAME"), "1 to 64 of letters, digits, . _ -")->required();
  add_value(*command, "--parts", options->parts, kind::part_count(), "number of parts")->required();
  add_value(*command, "--dims", options->dims, kind::dimensions(), "1, 2 or 3 dimensions")->capture_default_str();
  add_value(*command, "--method", options->method, kind::method(), "rcb, bands-x, bands-y or bands-z")
      ->capture_default_str();
  add_value(*command, "--tolerance", options->tolerance, kind::tolerance(), kToleranceHelp)->capture_default_str();
  add_value(*command, "--axis-hysteresis", options->axis_hysteresis, kind::number_from_one("H"), kHysteresisHelp)
      ->capture_default_str();
  add_value(*command, "--cut-tolerance", options->cut_tolerance, kind::number_between("E", 0, 1), kCutToleranceHelp)
      ->capture_default_str();
  add_value(*command, "--policy", options->policy, kind::policy(), kPolicyHelp)->capture_default_str();
  add_value(*command, "--recut", options->recut, kind::recut(), kRecutHelp)->capture_default_str();
  add_list(*command, "--part-sizes", options->part_sizes, kind::positive_number("LIST"), kPartSizesHelp);
  command->add_flag("--replace", options->replace, "drop a scene of that name first");

  add_command(*scene, context, {"list", "All scenes", "  rcbctl scene list --json"},
              [&context] { return list(context); });

  auto name = std::make_shared<std::string>();
  command = add_command(*scene, context, {"show", "One scene", "  rcbctl scene show jet"},
                        [name, &context] { return show(*name, context); });
  add_value(*command, "NAME", *name, kind::text("NAME"), "the scene")->required();
  command = add_command(*scene, context, {"drop", "Forgets a scene", "  rcbctl scene drop jet"},
                        [name, &context] { return drop(*name, context); });
  add_value(*command, "NAME", *name, kind::text("NAME"), "the scene")->required();
}

}  // namespace rcb::cli
