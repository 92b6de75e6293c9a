// Create and drop scenes. Only the coordinator knows who has a scene open; it refuses a request before it orders
// it.
#include <cmath>
#include <cstring>
#include <limits>

#include <fmt/format.h>

#include "common/cuts/cut_arrays.hpp"
#include "common/wire/field_reader.hpp"
#include "common/wire/limits.hpp"
#include "server/api/lists.hpp"
#include "server/service/context/context.hpp"
#include "server/service/step/step.hpp"

namespace rcb::service {

Scene Scene::create(std::string name, SceneOptions options) {
  Scene scene;
  scene.name = std::move(name);
  scene.particles.dims = options.dims;
  scene.options = std::move(options);
  return scene;
}

std::uint64_t Scene::cuts_hash() {
  if (!tree_hash) tree_hash = tree.hash();
  return *tree_hash;
}

const cuts::Cuts& Scene::snapshot() {
  if (!known_cuts || known_cuts->epoch() != epoch) known_cuts.emplace(tree, epoch);
  return *known_cuts;
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

Result<cuts::Method> read_method(const wire::Json& request, int dims, cuts::Method otherwise) {
  if (!request.contains("method") || request["method"].is_null()) return otherwise;
  const auto name = wire::string_field(request, "method", 64);
  if (!name.ok()) return name.status();
  const auto method = cuts::method_from_name(name.value());
  if (!method || *method == cuts::Method::equal_boxes || *method == cuts::Method::file_order)
    return Status(Code::invalid_argument, fmt::format("unknown method '{}'", name.value()),
                  "methods: rcb, bands-x, bands-y, bands-z");
  if (cuts::band_axis(*method).value_or(0) >= dims)
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

// The field's value by its name; `otherwise` if absent.
template <typename Value, typename FromName>
Result<Value> read_named(const wire::Json& request, const char* field, const char* names, FromName from_name,
                         Value otherwise) {
  if (!request.contains(field) || request[field].is_null()) return otherwise;
  const auto name = wire::string_field(request, field, 64);
  if (!name.ok()) return name.status();
  if (const auto value = from_name(name.value())) return *value;
  return Status(Code::invalid_argument, fmt::format("unknown {} '{}'", field, name.value()), names);
}

Result<SceneOptions> read_options(const wire::Json& request) {
  SceneOptions options;
  wire::FieldReader fields(request);
  options.parts = static_cast<int>(fields.integer("parts", 1, wire::kPartsMax));
  options.dims = static_cast<int>(fields.integer_or("dims", 1, 3, 3));
  options.tolerance = fields.number_or("tolerance", 0, kInfinity, 0.1, true);
  options.axis_hysteresis = fields.number_or("axis_hysteresis", 1, kLargest, 1.2);
  options.cut_tolerance = fields.number_or("cut_tolerance", 0, 1, 0);
  if (!fields.ok()) return fields.status();
  const auto method = read_method(request, options.dims, cuts::Method::rcb);
  if (!method.ok()) return method.status();
  options.method = method.value();
  const auto policy =
      read_named(request, "policy", "policies: tolerance, cost", scene::policy_from_name, scene::Policy::tolerance);
  if (!policy.ok()) return policy.status();
  options.policy = policy.value();
  const auto positions = read_named(request, "positions", "positions: every-step, when-needed", scene::travel_from_name,
                                    scene::Travel::every_step);
  if (!positions.ok()) return positions.status();
  options.positions = positions.value();
  if (const Status status = read_part_sizes(request, options); !status.ok()) return status;
  return options;
}

Response create(Context& context, const wire::Json& request) {
  wire::FieldReader fields(request);
  const std::string name = fields.text("scene", 256);
  if (fields.ok()) fields.fail(wire::check_scene_name(name));
  const bool replace = fields.flag("replace");
  if (!fields.ok()) return failed(fields.status());
  auto options = read_options(request);
  if (!options.ok()) return failed(options.status());
  const bool exists = context.scenes.contains(name);
  if (exists && !replace)
    return failed({Code::already_exists, fmt::format("scene '{}' exists already", name),
                   "drop it first, or create it with --replace"});
  if (!exists && context.scenes.size() >= static_cast<std::size_t>(wire::kScenesMax))
    return failed({Code::too_large, fmt::format("the service holds {} scenes, its limit", wire::kScenesMax),
                   "drop one: rcbctl scene drop NAME"});
  if (Status status = check_parts_total(context.scenes, name, options->parts); !status.ok())
    return failed(std::move(status));
  if (exists) context.spares.push_back({name, {}});
  Scene& made = context.scenes.insert_or_assign(name, Scene::create(name, std::move(options).value())).first->second;
  Response response = done(wire::Json::object());
  if (context.root()) response.change = {name, scene::Created{made.options, held_of(context, made)}};
  return response;
}

// An array of the order, which rank 0 has.
template <typename T>
std::vector<T> broadcast_array(Context& context, const char* name) {
  const wire::Array* array = nullptr;
  if (context.root()) array = wire::find_array(context.slices.front().arrays, name);
  std::uint64_t bytes = array == nullptr ? 0 : array->bytes.size();
  context.comm.broadcast(std::as_writable_bytes(std::span(&bytes, 1)), 0);
  std::vector<T> values(bytes / sizeof(T));
  if (array != nullptr && bytes > 0) std::memcpy(values.data(), array->bytes.data(), bytes);
  context.comm.broadcast(std::as_writable_bytes(std::span(values)), 0);
  return values;
}

// A scene of the service that ran here before: everything but its particles. Only rank 0 itself orders this.
Response restore(Context& context, const wire::Json& request) {
  auto options = read_options(request);
  if (!options.ok()) return failed(options.status());
  const auto name = request.at("scene").get<std::string>();
  Scene scene = Scene::create(name, *options);
  scene.epoch = request.at("epoch").get<std::uint64_t>();
  if (scene.epoch > 0) {
    cuts::CutArrays arrays{.dims = options->dims, .method = options->method, .parts = options->parts};
    arrays.part_sizes = broadcast_array<double>(context, "part_sizes");
    arrays.axes = broadcast_array<std::int32_t>(context, "axes");
    arrays.at = broadcast_array<double>(context, "at");
    arrays.id = broadcast_array<cuts::Id>(context, "id");
    auto tree = cuts::tree_of(arrays);
    if (!tree.ok()) return failed(tree.status());
    scene.tree = std::move(*tree);
  }
  scene.n = request.at("n").get<std::uint64_t>();
  scene.ids = request.at("ids").get<bool>();
  scene.particles.has_weights = request.at("weights").get<bool>();
  if (const auto next = request.find("id_next"); next != request.end()) scene.id_next = next->get<std::uint64_t>();
  context.scenes.insert_or_assign(name, std::move(scene));
  return done(wire::Json::object());
}

Response drop(Context& context, Scene& scene, const wire::Json&) {
  const std::string name = scene.name;
  context.scenes.erase(name);
  context.spares.push_back({name, {}});
  Response response = done(wire::Json::object());
  response.change = {name, scene::Dropped{}};
  return response;
}

constexpr Command kSceneCommands[] = {
    {"scene.create", create}, {"scene.restore", restore}, {"scene.drop", drop, Needs::scene}};

}  // namespace

std::span<const Command> scene_commands() { return kSceneCommands; }

}  // namespace rcb::service
