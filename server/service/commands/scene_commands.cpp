// Create and drop scenes. Only the coordinator knows who has a scene open; it refuses a request before it orders
// it.
#include <cstring>

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

const cuts::Cuts& Scene::snapshot() {
  if (!known_cuts || known_cuts->epoch() != epoch) known_cuts.emplace(*tree, epoch);
  return *known_cuts;
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

Response create(Context& context, const wire::Json& request) {
  wire::FieldReader fields(request);
  const std::string name = fields.text("scene", 256);
  if (fields.ok()) fields.fail(wire::check_scene_name(name));
  const bool replace = fields.flag("replace");
  if (!fields.ok()) return failed(fields.status());
  auto options = scene::read_options(request);
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
  context.options.spare->free(name);
  Scene& made = context.scenes.insert_or_assign(name, Scene::create(name, std::move(options).value())).first->second;
  Response response = done(wire::Json::object());
  if (context.root()) response.change = {name, scene::Created{made.options, made}};
  return response;
}

// An array of the order, which rank 0 has.
template <typename T>
std::vector<T> broadcast_array(Context& context, const char* name) {
  const wire::Array* array = nullptr;
  if (!context.slices.empty()) array = wire::find_array(context.slices.front().arrays, name);
  std::uint64_t bytes = array == nullptr ? 0 : array->bytes.size();
  context.comm.broadcast(std::as_writable_bytes(std::span(&bytes, 1)), 0);
  std::vector<T> values(bytes / sizeof(T));
  if (array != nullptr && bytes > 0) std::memcpy(values.data(), array->bytes.data(), bytes);
  context.comm.broadcast(std::as_writable_bytes(std::span(values)), 0);
  return values;
}

// A scene of the service that ran here before: everything but its particles. Only rank 0 itself orders this.
Response restore(Context& context, const wire::Json& request) {
  auto options = scene::read_options(request);
  if (!options.ok()) return failed(options.status());
  const auto name = request.at("scene").get<std::string>();
  const auto number = [&request](const char* of) { return request.at(of).get<std::uint64_t>(); };
  Scene scene = Scene::create(name, std::move(options).value());
  scene.epoch = number("epoch");
  scene.n = number("n");
  scene.search_rounds = number("rounds");
  scene.search_reductions = number("reductions");
  scene.ids = request.at("ids").get<bool>();
  scene.particles.has_weights = scene.weights = request.at("weights").get<bool>();
  if (scene.epoch > 0) {
    cuts::CutArrays arrays{.dims = scene.options.dims, .method = scene.options.method, .parts = scene.options.parts};
    arrays.part_sizes = broadcast_array<double>(context, "part_sizes");
    arrays.axes = broadcast_array<std::int32_t>(context, "axes");
    arrays.at = broadcast_array<double>(context, "at");
    arrays.id = broadcast_array<cuts::Id>(context, "id");
    auto tree = cuts::tree_of(arrays);
    if (!tree.ok()) return failed(tree.status());
    scene.hash = tree->hash();
    scene.tree = std::make_shared<const cuts::CutTree>(std::move(*tree));
  }
  if (const auto sum = request.find("id_sum"); sum != request.end()) scene.id_sum = sum->get<std::uint64_t>();
  context.scenes.insert_or_assign(name, std::move(scene));
  return done(wire::Json::object());
}

Response drop(Context& context, Scene& scene, const wire::Json&) {
  const std::string name = scene.name;
  context.scenes.erase(name);
  context.options.spare->free(name);
  Response response = done(wire::Json::object());
  response.change = {name, scene::Dropped{}};
  return response;
}

constexpr Command kSceneCommands[] = {
    {"scene.create", create}, {"scene.restore", restore}, {"scene.drop", drop, Needs::scene}};

}  // namespace

std::span<const Command> scene_commands() { return kSceneCommands; }

}  // namespace rcb::service
