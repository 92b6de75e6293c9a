// Create, show, drop scenes. Who has a scene open is the coordinator's knowledge: it refuses before it orders.
#include <cmath>
#include <limits>

#include <fmt/format.h>
#include <xxhash.h>

#include "common/wire/limits.hpp"
#include "server/service/context.hpp"
#include "server/service/lists.hpp"

namespace rcb::service {

Scene Scene::create(std::string name, SceneOptions options) {
  Scene scene;
  scene.name = std::move(name);
  scene.particles.dims = options.dims;
  scene.options = std::move(options);
  return scene;
}

std::uint64_t session_key(const std::string& session) { return XXH3_64bits(session.data(), session.size()); }

std::uint64_t Scene::cuts_hash() {
  if (!tree_hash) tree_hash = tree.hash();
  return *tree_hash;
}

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kLargest = std::numeric_limits<double>::max();
constexpr double kSizeRatioMax = 1e15;  // within it all sizes are exact in the integers of ExactScale

Status read_part_sizes(const wire::Json& request, SceneOptions& options) {
  auto sizes = wire::numbers_field_or_empty(request, "part_sizes", static_cast<std::size_t>(wire::kPartsMax));
  if (!sizes.ok()) return sizes.status();
  if (sizes->empty()) return {};
  if (sizes->size() != static_cast<std::size_t>(options.parts))
    return {Code::invalid_argument, fmt::format("part_sizes has {} entries for {} parts", sizes->size(), options.parts),
            "give one size a part"};
  for (std::size_t p = 0; p < sizes->size(); ++p)
    if (!std::isfinite(sizes.value()[p]) || !(sizes.value()[p] > 0))
      return {Code::invalid_argument, fmt::format("part_sizes[{}] is {}: must be finite and > 0", p, sizes.value()[p])};
  const auto [least, largest] = std::minmax_element(sizes->begin(), sizes->end());
  if (*largest > *least * kSizeRatioMax)
    return {Code::invalid_argument,
            fmt::format("part_sizes: {} is more than {} times {}", *largest, kSizeRatioMax, *least),
            "shares so far apart can't be met by whole particles"};
  options.part_sizes = std::move(sizes).value();
  return {};
}

}  // namespace

Result<partition::Method> read_method(const wire::Json& request, int dims, partition::Method otherwise) {
  if (!request.contains("method") || request["method"].is_null()) return otherwise;
  const auto name = wire::string_field(request, "method", 64);
  if (!name.ok()) return name.status();
  const auto method = partition::method_from_name(name.value());
  if (!method || *method == partition::Method::equal_boxes || *method == partition::Method::file_order)
    return Status(Code::invalid_argument, fmt::format("unknown method '{}'", name.value()),
                  "methods: rcb, bands-x, bands-y, bands-z");
  if ((*method == partition::Method::bands_y && dims < 2) || (*method == partition::Method::bands_z && dims < 3))
    return Status(Code::invalid_argument,
                  fmt::format("method {} needs an axis that {} dimension(s) don't have", name.value(), dims));
  return *method;
}

Status check_parts_total(const std::map<std::string, Scene>& scenes, const std::string& changed, int parts) {
  std::int64_t total = parts;
  for (const auto& [name, scene] : scenes) total += name == changed ? 0 : scene.options.parts;
  if (total <= wire::kPartsTotalMax) return {};
  return {
      Code::too_large,
      fmt::format("the service's scenes would have {} parts together, {} is its limit", total, wire::kPartsTotalMax),
      "drop a scene: rcbctl scene drop NAME"};
}

namespace {

Result<Policy> read_policy(const wire::Json& request) {
  if (!request.contains("policy") || request["policy"].is_null()) return Policy::tolerance;
  const auto name = wire::string_field(request, "policy", 64);
  if (!name.ok()) return name.status();
  const auto policy = policy_from_name(name.value());
  if (!policy)
    return Status(Code::invalid_argument, fmt::format("unknown policy '{}'", name.value()),
                  "policies: tolerance, cost");
  return *policy;
}

Result<SceneOptions> read_options(const wire::Json& request) {
  SceneOptions options;
  const auto parts = wire::integer_field(request, "parts", 1, wire::kPartsMax);
  if (!parts.ok()) return parts.status();
  const auto dims = wire::integer_field_or(request, "dims", 1, 3, 3);
  if (!dims.ok()) return dims.status();
  const auto tolerance = wire::number_field_or(request, "tolerance", 0, kInfinity, 0.1, true);
  if (!tolerance.ok()) return tolerance.status();
  const auto hysteresis = wire::number_field_or(request, "axis_hysteresis", 1, kLargest, 1.2);
  if (!hysteresis.ok()) return hysteresis.status();
  const auto cut_tolerance = wire::number_field_or(request, "cut_tolerance", 0, 1, 0);
  if (!cut_tolerance.ok()) return cut_tolerance.status();
  options.cut_tolerance = cut_tolerance.value();
  options.parts = static_cast<int>(parts.value());
  options.dims = static_cast<int>(dims.value());
  options.tolerance = tolerance.value();
  options.axis_hysteresis = hysteresis.value();
  const auto method = read_method(request, options.dims, partition::Method::rcb);
  if (!method.ok()) return method.status();
  options.method = method.value();
  const auto policy = read_policy(request);
  if (!policy.ok()) return policy.status();
  options.policy = policy.value();
  const auto recut = request.contains("recut") ? wire::string_field(request, "recut", 16) : std::string("all");
  if (!recut.ok()) return recut.status();
  if (recut.value() != "all" && recut.value() != "subtree")
    return Status(Code::invalid_argument, fmt::format("unknown recut '{}'", recut.value()), "recut: all, subtree");
  options.recut = recut.value() == "all" ? Recut::all : Recut::subtree;
  if (const Status status = read_part_sizes(request, options); !status.ok()) return status;
  return options;
}

Response describe_scene(Scene& scene) {
  const SceneOptions& options = scene.options;
  wire::Json json{{"scene", scene.name},
                  {"n", scene.n},
                  {"dims", options.dims},
                  {"parts", options.parts},
                  {"method", partition::method_name(options.method)},
                  {"tolerance", wire::number_json(options.tolerance)},
                  {"axis_hysteresis", options.axis_hysteresis},
                  {"cut_tolerance", options.cut_tolerance},
                  {"policy", policy_name(options.policy)},
                  {"recut", options.recut == Recut::all ? "all" : "subtree"},
                  {"part_sizes", nullptr},
                  {"weights", scene.particles.has_weights},
                  {"ids", scene.ids},
                  {"step", scene.step ? wire::Json(*scene.step) : wire::Json(nullptr)},
                  {"epoch", scene.epoch},
                  {"plan", {{"version", scene.plan_version}, {"checksum", wire::hex64(scene.plan_checksum)}}}};
  for (const char* name : {"error", "imbalance", "counts", "targets", "hash", "rounds", "reductions"})
    json[name] = nullptr;
  Response response = done(std::move(json));
  if (!options.part_sizes.empty()) put_list<double>(response, response.json, "part_sizes", options.part_sizes);
  if (!scene.pushed) return response;
  response.json["error"] = scene.loads.error;
  response.json["imbalance"] = scene.loads.imbalance;
  response.json["hash"] = wire::hex64(scene.cuts_hash());
  response.json["rounds"] = scene.search_rounds;
  response.json["reductions"] = scene.search_reductions;
  put_loads(response, scene);
  return response;
}

Response show(Context& context, const wire::Json& request) {
  const auto scene = find_scene(context, request);
  if (!scene.ok()) return failed(scene.status());
  if (!context.root()) return {};
  Response response = describe_scene(*scene.value());
  response.json["ranks"] = context.comm.size();
  return response;
}

Response create(Context& context, const wire::Json& request) {
  const auto name = wire::string_field(request, "scene", 256);
  if (!name.ok()) return failed(name.status());
  if (Status status = wire::check_scene_name(name.value()); !status.ok()) return failed(std::move(status));
  const auto replace = wire::bool_field_or(request, "replace", false);
  if (!replace.ok()) return failed(replace.status());
  const auto recreated = wire::bool_field_or(request, "recreated", false);
  if (!recreated.ok()) return failed(recreated.status());
  auto options = read_options(request);
  if (!options.ok()) return failed(options.status());
  const bool exists = context.scenes.contains(name.value());
  if (exists && !replace.value())
    return failed({Code::already_exists, fmt::format("scene '{}' exists already", name.value()),
                   "drop it first, or create it with --replace"});
  if (!exists && context.scenes.size() >= static_cast<std::size_t>(wire::kScenesMax))
    return failed({Code::too_large, fmt::format("the service holds {} scenes, its limit", wire::kScenesMax),
                   "drop one: rcbctl scene drop NAME"});
  if (Status status = check_parts_total(context.scenes, name.value(), options->parts); !status.ok())
    return failed(std::move(status));
  if (exists) context.spares.push_back({name.value(), {}});
  Scene scene = Scene::create(name.value(), std::move(options).value());
  scene.recreated = recreated.value();
  if (context.root()) scene.history = std::make_unique<History>(context.histories, name.value());
  context.scenes.insert_or_assign(name.value(), std::move(scene));
  return show(context, request);
}

Response drop(Context& context, const wire::Json& request) {
  const auto scene = find_scene(context, request);
  if (!scene.ok()) return failed(scene.status());
  const std::string name = scene.value()->name;
  context.scenes.erase(name);
  context.spares.push_back({name, {}});
  return done(wire::Json::object());
}

constexpr Command kCommands[] = {
    {"scene.create", create}, {"scene.show", show}, {"scene.open", show}, {"scene.drop", drop}};

}  // namespace

std::span<const Command> scene_commands() { return kCommands; }

}  // namespace rcb::service
