#include "server/scene/options.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include <fmt/format.h>

#include "common/wire/field_reader.hpp"
#include "common/wire/limits.hpp"

namespace rcb::scene {
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
  const auto policy = read_named(request, "policy", "policies: tolerance, cost", policy_from_name, Policy::tolerance);
  if (!policy.ok()) return policy.status();
  options.policy = policy.value();
  const auto positions =
      read_named(request, "positions", "positions: every-step, when-needed", travel_from_name, Travel::every_step);
  if (!positions.ok()) return positions.status();
  options.positions = positions.value();
  if (const Status status = read_part_sizes(request, options); !status.ok()) return status;
  return options;
}

wire::Json to_json(const SceneOptions& options) {
  return {{"parts", options.parts},
          {"dims", options.dims},
          {"method", cuts::method_name(options.method)},
          {"tolerance", wire::number_json(options.tolerance)},
          {"axis_hysteresis", options.axis_hysteresis},
          {"cut_tolerance", options.cut_tolerance},
          {"policy", policy_name(options.policy)},
          {"positions", travel_name(options.positions)}};
}

}  // namespace rcb::scene
