// Quality and comparison of partitions: computed on request only, without changing anything.
#include <algorithm>
#include <limits>

#include <fmt/format.h>

#include "common/partition/partition.hpp"
#include "common/partition/quality/quality.hpp"
#include "common/wire/limits.hpp"
#include "server/api/lists.hpp"
#include "server/service/commands/cuts_json.hpp"
#include "server/service/commands/quality_json.hpp"
#include "server/service/context/collective.hpp"

namespace rcb::service {
namespace {

using api::put_list;

using cuts::Method;

// A short description of a value that is not a method.
std::string shown(const wire::Json& value) {
  if (!value.is_string()) return fmt::format("a value of type {}", value.type_name());
  return fmt::format("'{}'", value.get<std::string>().substr(0, 64));
}

Result<std::optional<double>> ghost_width(const wire::Json& request) {
  const auto width = wire::number_field_or(request, "ghost_width", 0, std::numeric_limits<double>::max(), -1);
  if (!width.ok()) return width.status();
  if (width.value() < 0) return std::optional<double>{};
  return std::optional<double>{width.value()};
}

Response quality(Context& context, Scene& s, const wire::Json& request) {
  const auto width = ghost_width(request);
  if (!width.ok()) return failed(width.status());
  constexpr std::uint64_t kBytesOfPart = 1024;
  constexpr std::uint64_t kReaches = std::uint64_t{32} << 20U;  // ranges of parts that are near a part's particles
  if (Status room = agree_room(
          context.comm, s.part.size() * 8 + static_cast<std::uint64_t>(s.options.parts) * kBytesOfPart + kReaches,
          fmt::format("the quality of {} parts", s.options.parts));
      !room.ok())
    return failed(std::move(room));
  Status time;
  const auto found = partition::quality(context.comm, s.particles.view(), s.part.span(), s.options.parts, s.tree.get(),
                                        width.value(), while_in_time(context, time));
  if (!found) return failed(std::move(time));
  if (!context.root()) return {};
  Response response = done({{"scene", s.name}, {"epoch", s.epoch}, {"narrowest_region", narrowest_json(s.snapshot())}});
  put_quality(response, response.json, *found);
  return response;
}

// The methods that `compare` has for this number of dimensions, in the paper's order.
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
    const auto method = name.is_string() ? cuts::method_from_name(name.get<std::string>()) : std::nullopt;
    if (!method || std::find(allowed.begin(), allowed.end(), *method) == allowed.end())
      return Status(Code::invalid_argument, fmt::format("methods: {} isn't one for {} dimension(s)", shown(name), dims),
                    "methods: equal-boxes, file-order, bands-x, bands-y, bands-z, rcb");
    if (std::find(methods.begin(), methods.end(), *method) != methods.end())
      return Status(Code::invalid_argument, fmt::format("methods: {} stands twice", shown(name)));
    methods.push_back(*method);
  }
  return methods;
}

// Computes one row of the paper's Table 1. Errors: those of check_time. Collective.
Status compare_one(Context& context, const Scene& scene, const partition::PartitionOptions& options,
                   std::optional<double> width, Response& response) {
  const auto view = scene.particles.view();
  context.comm.barrier();
  const double start = context.clock.seconds();
  Status time;
  auto found = partition::partition(context.comm, view, options, while_in_time(context, time));
  if (!time.ok()) return time;
  RCB_CHECK(found.ok(), found.status().message());
  const double seconds = context.clock.seconds() - start;
  const auto loads =
      partition::summarise_loads(context.comm, view, found->part.span(), options.part_sizes, options.parts);
  time = context.check_time();
  if (!time.ok()) return time;
  const auto metrics = partition::quality(context.comm, view, found->part.span(), options.parts,
                                          cuts::has_cut_tree(options.method) ? &found->tree : nullptr, width,
                                          while_in_time(context, time));
  if (!metrics) return time;
  if (!context.root()) return {};
  wire::Json row{{"method", cuts::method_name(options.method)},
                 {"error", loads.error},
                 {"imbalance", loads.imbalance},
                 {"seconds", seconds}};
  put_list<double>(response, row, "errors", loads.part_errors);
  put_list<std::uint64_t>(response, row, "counts", loads.counts);
  put_quality(response, row, *metrics);
  response.json["ghost_width"] = metrics->ghost_width;
  response.json["methods"].push_back(std::move(row));
  return {};
}

Response compare(Context& context, Scene& s, const wire::Json& request) {
  const auto width = ghost_width(request);
  if (!width.ok()) return failed(width.status());
  const auto parts = wire::integer_field_or(request, "parts", 1, wire::kPartsMax, s.options.parts);
  if (!parts.ok()) return failed(parts.status());
  const auto methods = read_methods(request, s.options.dims);
  if (!methods.ok()) return failed(methods.status());

  partition::PartitionOptions options;
  options.parts = static_cast<int>(parts.value());
  options.part_sizes = s.options.part_sizes;
  if (!options.part_sizes.empty() && options.parts != s.options.parts)
    return failed({Code::invalid_argument, fmt::format("scene '{}' has sizes for {} parts", s.name, s.options.parts),
                   "leave 'parts' out, or compare in a scene without part sizes"});
  Response response = done({{"scene", s.name},
                            {"n", s.n},
                            {"parts", options.parts},
                            {"ghost_width", 0.0},
                            {"methods", wire::Json::array()}});
  Status room = agree_room_to_partition(context.comm, s.particles.count(), options.parts);
  if (!room.ok()) return failed(std::move(room));
  for (const Method method : methods.value()) {
    options.method = method;
    if (Status status = context.check_time(); !status.ok()) return failed(std::move(status));
    if (Status status = compare_one(context, s, options, width.value(), response); !status.ok())
      return failed(std::move(status));
  }
  if (!context.root()) return {};
  for (wire::Array& array : response.arrays) array.shape = {methods->size(), static_cast<std::uint64_t>(options.parts)};
  return response;
}

constexpr Command kQualityCommands[] = {{"quality", quality, Needs::positions, true},
                                        {"compare", compare, Needs::positions, true}};

}  // namespace

void put_quality(Response& response, wire::Json& json, const partition::Quality& quality) {
  json["ghost_width"] = quality.ghost_width;
  put_list<std::uint64_t>(response, json, "ghosts", quality.ghosts);
  put_list<std::int32_t>(response, json, "neighbours", quality.neighbours);
  json["interface_area"] = json["interface_areas"] = nullptr;
  if (quality.interface_area) json["interface_area"] = wire::number_json(*quality.interface_area);
  // When several methods share one array, each must have its row, even one without interface areas: its row is NaN.
  const std::vector<double> none(quality.ghosts.size(), std::numeric_limits<double>::quiet_NaN());
  if (quality.interface_area || none.size() > wire::kListedMax)
    put_list<double>(response, json, "interface_areas", quality.interface_area ? quality.part_interface_area : none);
}

comm::GoOn while_in_time(Context& context, Status& status) {
  return [&context, &status] {
    status = context.check_time();
    return status.ok();
  };
}

std::span<const Command> quality_commands() { return kQualityCommands; }

}  // namespace rcb::service
