#include "server/service/commands/geometry_fields.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include <fmt/format.h>

#include "common/base/axis_names.hpp"
#include "common/wire/field_reader.hpp"

namespace rcb::service {
namespace {

constexpr double kUnbounded = std::numeric_limits<double>::infinity();

Result<geometry::Point> corner_field(const wire::Json& object, const char* name, const std::string& prefix, int dims,
                                     double unbounded) {
  wire::Json values = object.value(name, wire::Json());
  std::vector<std::size_t> open;
  for (std::size_t a = 0; values.is_array() && a < std::min<std::size_t>(values.size(), geometry::kDimsMax); ++a)
    if (values[a].is_null()) {
      open.push_back(a);
      values[a] = 0;
    }
  auto point = point_field({{name, std::move(values)}}, name, prefix + name, dims);
  if (!point.ok()) return point;
  for (const std::size_t a : open) (*point)[a] = unbounded;
  return point;
}

}  // namespace

Result<geometry::Point> point_field(const wire::Json& object, const char* name, const std::string& label, int dims) {
  const auto values = wire::numbers_field_or_empty(object, name, 16);
  if (!values.ok()) return values.status();
  if (values->size() != static_cast<std::size_t>(dims))
    return Status(Code::invalid_argument,
                  fmt::format("{}: {} number{} given, the scene has {} dimension{}", label, values->size(),
                              values->size() == 1 ? "" : "s", dims, dims == 1 ? "" : "s"),
                  "give one number a dimension");
  geometry::Point point{};
  for (std::size_t a = 0; a < values->size(); ++a) {
    point[a] = values.value()[a];
    if (!std::isfinite(point[a]))
      return Status(Code::not_finite, fmt::format("{}[{}] is {}: must be finite", label, a, point[a]));
  }
  return point;
}

Result<geometry::Box> box_fields(const wire::Json& object, const std::string& prefix, int dims) {
  const auto lo = corner_field(object, "lo", prefix, dims, -kUnbounded);
  if (!lo.ok()) return lo.status();
  const auto hi = corner_field(object, "hi", prefix, dims, kUnbounded);
  if (!hi.ok()) return hi.status();
  for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a)
    if (lo.value()[a] > hi.value()[a])
      return Status(
          Code::invalid_argument,
          fmt::format("{}: {}lo {} is above {}hi {}", kAxisNames[a], prefix, lo.value()[a], prefix, hi.value()[a]),
          "give the low corner first, then the high one");
  return geometry::Box{*lo, *hi};
}

Result<cuts::PeriodicBox> periodic_field(const wire::Json& request, int dims) {
  const auto found = request.find("periodic");
  if (found == request.end() || found->is_null()) return cuts::PeriodicBox();
  if (!found->is_object())
    return Status(Code::invalid_argument, "field 'periodic': expected an object with 'lo' and 'hi'");
  const auto corners = box_fields(*found, "periodic.", dims);
  if (!corners.ok()) return corners.status();
  cuts::PeriodicBox box;
  for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a) {
    box.lo[a] = corners->lo[a];
    box.hi[a] = corners->hi[a];
  }
  if (Status status = cuts::Near{.box = box}.check(dims); !status.ok()) return status;
  return box;
}

Result<cuts::Near> near_fields(const wire::Json& request, int dims) {
  wire::FieldReader fields(request);
  cuts::Near near;
  near.width = fields.number_or("width", 0, std::numeric_limits<double>::max(), -1);
  if (fields.ok() && near.width < 0)
    fields.fail({Code::invalid_argument, "field 'width': expected a number of at least 0, got nothing"});
  near.norm = fields.word("norm", {"max", "euclid"}) == "max" ? cuts::Norm::max : cuts::Norm::euclid;
  if (!fields.ok()) return fields.status();
  const auto periodic = periodic_field(request, dims);
  if (!periodic.ok()) return periodic.status();
  near.box = *periodic;
  return near;
}

}  // namespace rcb::service
