// owner, box, assign: which part owns a position, a box, each particle.
#include <algorithm>
#include <cmath>
#include <span>

#include <fmt/format.h>

#include "client/cli/commands/near.hpp"
#include "client/cli/files/point_file.hpp"
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
  std::vector<std::string> periodic;
};

enum class Ids { rows, own };  // of a scene: the numbers of the rows, or given by its solver

struct AssignOptions {
  std::string name;
  std::string out;
  FileOptions rows;
  bool held = false;
  double deadline_seconds = kQuestionSeconds;
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

// A corner in JSON, which has no infinity: null where the box is unbounded. outward: -1 for the low corner, 1 for the
// high one.
Result<Json> corner_json(std::span<const double> corner, double outward) {
  Json json = Json::array();
  for (const double value : corner) {
    if (std::isinf(value) && value * outward < 0)
      return Status(Code::usage, fmt::format("a box whose {} corner is at {}", outward < 0 ? "low" : "high", value),
                    "-inf stands in the low corner, inf in the high one");
    json.push_back(std::isinf(value) ? Json() : Json(value));
  }
  return json;
}

Status box(const BoxOptions& options, const Context& context) {
  const std::size_t dims = options.corners.size() / 2;
  if (options.corners.size() % 2 != 0)
    return {Code::usage, fmt::format("a box has two corners, but {} numbers were given", options.corners.size()),
            "rcbctl box NAME LO... HI..., such as: rcbctl box jet 0 0 1 1"};
  const auto lo = corner_json(std::span(options.corners).first(dims), -1);
  if (!lo) return lo.status();
  const auto hi = corner_json(std::span(options.corners).last(dims), 1);
  if (!hi) return hi.status();
  const auto periodic = periodic_json(options.periodic);
  if (!periodic) return periodic.status();
  return ask_and_show(context, "box", {{"scene", options.name}, {"lo", *lo}, {"hi", *hi}, {"periodic", *periodic}},
                      [](const Json& reply) { print_line("parts " + text_of(reply, "parts")); });
}

// The parts of the particles that a file's rows name by their ids.
Status write_by_rows(const AssignOptions& options, Ids ids, std::span<const std::int64_t> id,
                     std::span<const std::int32_t> part) {
  const auto points = read_single(options.rows);
  if (!points) return points.status();
  if (points->id.empty() && ids == Ids::own)
    return {Code::invalid_argument,
            fmt::format("{}: no column 'id', and scene '{}' has ids of its own", options.rows.path, options.name),
            "name the columns, as in \"id,x,y,z\""};
  std::vector<std::int32_t> by_row;
  by_row.reserve(points->count);
  for (std::size_t row = 0; row < points->count; ++row) {
    const std::int64_t wanted = points->id.empty() ? static_cast<std::int64_t>(row) : points->id[row];
    const auto found = std::ranges::lower_bound(id, wanted);
    if (found == id.end() || *found != wanted)
      return {Code::not_found, fmt::format("{}: scene '{}' has no id {}", options.rows.path, options.name, wanted),
              "give the file that was pushed last"};
    by_row.push_back(part[static_cast<std::size_t>(found - id.begin())]);
  }
  return io::write_npy(options.out, by_row);
}

// The parts by row. Where the scene has ids of its own the service doesn't know the rows: then those of a file or,
// without one, in ascending order of the ids.
Status write_assignment(const AssignOptions& options, Ids ids, const client::Reply& reply) {
  const client::Array* part = reply.find("part");
  const client::Array* id = reply.find("id");
  if (part == nullptr || id == nullptr || id->i8().size() != part->i4().size())
    return {Code::protocol_error, "the answer to assign lacks its ids or parts"};
  if (!options.rows.path.empty()) return write_by_rows(options, ids, id->i8(), part->i4());
  return io::write_npy(options.out, part->i4());
}

Status assign(const AssignOptions& options, const Context& context) {
  if (Status status = check_not_overwritten("--out", options.out, {&options.rows.path, 1}); !status) return status;
  auto client = connect(context);
  if (!client) return client.status();
  const auto shown = ask(*client, "scene.show", {{"scene", options.name}}, options.deadline_seconds);
  if (!shown) return shown.status();
  auto answer = ask_arrays(*client, "assign", {{"scene", options.name}, {"checksum", true}, {"held", options.held}},
                           options.deadline_seconds);
  if (!answer) return answer.status();
  const Ids ids = shown->at("ids").get<bool>() ? Ids::own : Ids::rows;
  if (Status status = write_assignment(options, ids, answer->reply); !status) return status;
  const bool by_id = options.rows.path.empty() && ids == Ids::own;
  answer->json["file"] = options.out;
  answer->json["order"] = by_id ? "ids" : "rows";
  if (by_id)
    note(
        fmt::format("scene '{}' has ids of its own: the parts are in ascending order of these; with the file that was "
                    "pushed (rcbctl assign {} FILE ...) they are in the order of its rows",
                    options.name, options.name));
  return show(context, answer->json, [&] {
    print_line(fmt::format("{}: the part of each of {} {}", options.out, text_of(answer->json, "n"),
                           by_id ? "points, by ascending id" : "rows"));
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

  auto [touches, corners] = add_command(app, context,
                                        {"box", "Which parts touch a box",
                                         "  rcbctl box jet -1 -1 -1 1 1 1\n  rcbctl box jet -inf 0 0 0.5 1 inf\n"
                                         "  rcbctl box jet .9 0 0 1.1 1 1 --periodic 0 - - 1 - -",
                                         kAskGroup},
                                        box);
  add_scene_name(touches, corners.name);
  add_value(touches, "CORNERS", corners.corners, kind::number_or_infinity("LO... HI..."),
            "the low corner, then the high one; -inf and inf where it has no bound")
      ->required()
      ->expected(2, 6);
  add_periodic(touches, corners.periodic);

  auto [assigns, array] =
      add_command(app, context,
                  {"assign", "Writes the part of each row (int32)",
                   "  rcbctl assign jet --out parts.npy\n  rcbctl assign jet step7.csv --out parts.npy", kSceneGroup},
                  assign);
  add_scene_name(assigns, array.name);
  add_value(
      assigns, "--out", array.out, kind::output_file(kind::Format::npy),
      "the array: by row as first pushed or, where the scene has ids of its own and no FILE is given, by ascending id")
      ->required();
  add_file_options(assigns, array.rows)->required(false)->description("whose rows are meant, by their ids");
  add_deadline(assigns, array.deadline_seconds);
  add_held(assigns, array.held);
}

}  // namespace rcb::cli
