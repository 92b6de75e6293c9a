// Quality and comparison of partitions: computed only when asked, and nothing is changed.
#include <algorithm>
#include <limits>

#include <fmt/format.h>

#include "common/partition/partition.hpp"
#include "common/partition/quality.hpp"
#include "common/wire/limits.hpp"
#include "server/service/context.hpp"
#include "server/service/quality_json.hpp"

namespace rcb::service {
namespace {

using partition::Method;

Result<std::optional<double>> ghost_width(const wire::Json& request) {
  const auto width = wire::number_field_or(request, "ghost_width", 0, std::numeric_limits<double>::max(), -1);
  if (!width.ok()) return width.status();
  if (width.value() < 0) return std::optional<double>{};
  return std::optional<double>{width.value()};
}

Response quality(Context& context, const wire::Json& request) {
  const auto scene = find_pushed_scene(context, request);
  if (!scene.ok()) return failed(scene.status());
  const auto width = ghost_width(request);
  if (!width.ok()) return failed(width.status());
  const Scene& s = *scene.value();
  const auto found =
      partition::quality(context.comm, s.particles.view(), s.part.span(), s.options.parts, &s.tree, width.value());
  wire::Json json = quality_json(found);
  json["scene"] = s.name;
  json["epoch"] = s.epoch;
  return done(std::move(json));
}

// The methods that `compare` shows for this many dimensions, in the paper's order.
std::vector<Method> methods_for(int dims) {
  std::vector<Method> methods{Method::equal_boxes, Method::file_order, Method::bands_x};
  if (dims > 1) methods.push_back(Method::bands_y);
  if (dims > 2) methods.push_back(Method::bands_z);
  methods.push_back(Method::rcb);
  return methods;
}

Result<std::vector<Method>> read_methods(const wire::Json& request, int dims) {
  if (!request.contains("methods") || request["methods"].is_null()) return methods_for(dims);
  if (!request["methods"].is_array())
    return Status(Code::invalid_argument, "field 'methods': expected a list of names");
  std::vector<Method> methods;
  const auto allowed = methods_for(dims);
  for (const wire::Json& name : request["methods"]) {
    const auto method = name.is_string() ? partition::method_from_name(name.get<std::string>()) : std::nullopt;
    if (!method || std::find(allowed.begin(), allowed.end(), *method) == allowed.end())
      return Status(Code::invalid_argument, fmt::format("methods: {} isn't one for {} dimension(s)", name.dump(), dims),
                    "methods: equal-boxes, file-order, bands-x, bands-y, bands-z, rcb");
    methods.push_back(*method);
  }
  return methods;
}

// One row of the paper's Table 1. Collective.
wire::Json compare_one(Context& context, const Scene& scene, const partition::PartitionOptions& options,
                       std::optional<double> width) {
  const auto view = scene.particles.view();
  context.comm.barrier();
  const double start = context.clock.seconds();
  auto found = partition::has_cut_tree(options.method) && options.method != Method::equal_boxes
                   ? partition::partition(context.comm, view, options)
                   : partition::baseline(context.comm, view, options);
  CHECK(found.ok(), found.status().message());
  const double seconds = context.clock.seconds() - start;
  const auto loads =
      partition::summarise_loads(context.comm, view, found->part.span(), options.part_sizes, options.parts);
  const auto metrics = partition::quality(context.comm, view, found->part.span(), options.parts,
                                          partition::has_cut_tree(options.method) ? &found->tree : nullptr, width);
  wire::Json json = quality_json(metrics);
  json["method"] = partition::method_name(options.method);
  json["error"] = loads.error;
  json["errors"] = loads.part_errors;
  json["counts"] = loads.counts;
  json["imbalance"] = loads.imbalance;
  json["seconds"] = seconds;
  return json;
}

Response compare(Context& context, const wire::Json& request) {
  const auto scene = find_pushed_scene(context, request);
  if (!scene.ok()) return failed(scene.status());
  const Scene& s = *scene.value();
  const auto width = ghost_width(request);
  if (!width.ok()) return failed(width.status());
  const auto parts = wire::integer_field_or(request, "parts", 1, wire::kPartsMax, s.options.parts);
  if (!parts.ok()) return failed(parts.status());
  const auto methods = read_methods(request, s.options.dims);
  if (!methods.ok()) return failed(methods.status());

  partition::PartitionOptions options;
  options.parts = static_cast<int>(parts.value());
  if (options.parts == s.options.parts) options.part_sizes = s.options.part_sizes;
  wire::Json rows = wire::Json::array();
  double used_width = 0;
  for (const Method method : methods.value()) {
    options.method = method;
    rows.push_back(compare_one(context, s, options, width.value()));
    used_width = rows.back()["ghost_width"].get<double>();
  }
  return done({{"scene", s.name},
               {"n", s.n},
               {"parts", options.parts},
               {"ghost_width", used_width},
               {"methods", std::move(rows)}});
}

constexpr Command kCommands[] = {{"quality", quality, true}, {"compare", compare, true}};

}  // namespace

wire::Json quality_json(const partition::Quality& quality) {
  wire::Json json{{"ghost_width", quality.ghost_width},
                  {"ghosts", quality.ghosts},
                  {"neighbours", quality.neighbours},
                  {"interface_area", nullptr},
                  {"interface_areas", nullptr}};
  if (quality.interface_area) {
    json["interface_area"] = wire::number_json(*quality.interface_area);
    wire::Json areas = wire::Json::array();
    for (const double area : quality.part_interface_area) areas.push_back(wire::number_json(area));
    json["interface_areas"] = std::move(areas);
  }
  return json;
}

std::span<const Command> quality_commands() { return kCommands; }

}  // namespace rcb::service
