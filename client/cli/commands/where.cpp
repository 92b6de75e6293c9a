// owner, box, assign: which part owns a position, a box, each particle.

#include <fmt/format.h>

#include "client/cli/app.hpp"
#include "client/cli/print/output.hpp"
#include "common/io/points.hpp"

namespace rcb::cli {
namespace {

struct OwnerOptions {
  std::string name;
  std::vector<double> position;
  std::optional<std::int64_t> id;
};

struct BoxOptions {
  std::string name;
  std::vector<double> corners;
};

struct AssignOptions {
  std::string name;
  std::string out;
};

Status owner(const OwnerOptions& options, const Context& context) {
  Json arguments{{"scene", options.name}, {"position", options.position}};
  if (options.id) arguments["id"] = *options.id;
  return ask_and_show(context, "owner", arguments, [](const Json& reply) {
    print_line(reply.at("owner").is_null()
                   ? fmt::format("parts {} (a particle's id decides: --id)", text_of(reply, "candidates"))
                   : "part " + text_of(reply, "owner"));
  });
}

Status box(const BoxOptions& options, const Context& context) {
  const std::size_t dims = options.corners.size() / 2;
  if (options.corners.size() % 2 != 0)
    return {Code::usage, fmt::format("a box has two corners, but {} numbers were given", options.corners.size()),
            "rcbctl box NAME LO... HI..., such as: rcbctl box jet 0 0 1 1"};
  const auto middle = options.corners.begin() + static_cast<std::ptrdiff_t>(dims);
  return ask_and_show(context, "box",
                      {{"scene", options.name},
                       {"lo", std::vector<double>(options.corners.begin(), middle)},
                       {"hi", std::vector<double>(middle, options.corners.end())}},
                      [](const Json& reply) { print_line("parts " + text_of(reply, "parts")); });
}

Status assign(const AssignOptions& options, const Context& context) {
  auto client = connect(context);
  if (!client) return client.status();
  auto answer = ask_arrays(*client, "assign", {{"scene", options.name}, {"checksum", true}});
  if (!answer) return answer.status();
  const client::Array* part = answer->reply.find("part");
  if (part == nullptr) return {Code::protocol_error, "the answer to assign lacks its parts"};
  if (Status status = io::write_npy(options.out, part->i4()); !status) return status;
  answer->json["file"] = options.out;
  return show(context, answer->json, [&] {
    print_line(fmt::format("{}: the part of each of {} points, in id order", options.out, part->i4().size()));
  });
}

}  // namespace

void add_where_commands(CLI::App& app, Context& context) {
  auto [owns, position] =
      add_command(app, context,
                  {"owner", "Which part owns a position",
                   "  rcbctl owner jet 0.5 -.25 1e-3\n  rcbctl owner jet 0.5 0.5 0.5 --id 12", kAskGroup},
                  owner);
  add_scene_name(owns, position.name);
  add_value(owns, "X", position.position, kind::number("X [Y [Z]]"), "as many coordinates as the scene has")
      ->required()
      ->expected(1, 3);
  add_value(owns, "--id", position.id, kind::whole_number("I", 0), "of the particle: decides where positions tie");

  auto [touches, corners] =
      add_command(app, context, {"box", "Which parts touch a box", "  rcbctl box jet -1 -1 -1 1 1 1", kAskGroup}, box);
  add_scene_name(touches, corners.name);
  add_value(touches, "CORNERS", corners.corners, kind::number("LO... HI..."), "the low corner, then the high one")
      ->required()
      ->expected(2, 6);

  auto [assigns, array] = add_command(app, context,
                                      {"assign", "Writes the part of each particle, in id order (int32)",
                                       "  rcbctl assign jet --out parts.npy", kSceneGroup},
                                      assign);
  add_scene_name(assigns, array.name);
  add_value(assigns, "--out", array.out, kind::output_file(kind::Format::npy), "the array")->required();
}

}  // namespace rcb::cli
