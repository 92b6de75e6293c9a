#include "client/cli/commands/near.hpp"

#include <cstdlib>
#include <span>

#include <fmt/format.h>

#include "client/cli/print/output.hpp"

namespace rcb::cli {
namespace {

constexpr const char* kOpen = "-";

Json periodic_corner(std::span<const std::string> bounds) {
  Json corner = Json::array();
  for (const std::string& bound : bounds)
    corner.push_back(bound == kOpen ? Json() : Json(std::strtod(bound.c_str(), nullptr)));
  return corner;
}

}  // namespace

void add_periodic(CLI::App& command, std::vector<std::string>& bounds) {
  add_value(command, "--periodic", bounds, kind::number_or("LO... HI...", kOpen),
            "the periodic box: its low corner, then the high one; - for both where an axis isn't periodic")
      ->expected(2, 6);
}

void add_near_options(CLI::App& command, NearOptions& options) {
  add_scene_name(command, options.name);
  add_value(command, "--width", options.width, kind::number_from_zero("H"), "the distance from a part's region")
      ->required();
  add_periodic(command, options.periodic);
  add_value(command, "--norm", options.norm, kind::one_of("NORM", {"max", "euclid"}),
            "of the distance: the largest along an axis, or Euclid's")
      ->capture_default_str();
  command.add_flag("--all", options.all, kAllHelp);
  add_deadline(command, options.deadline_seconds);
}

Result<Json> periodic_json(const std::vector<std::string>& bounds) {
  if (bounds.empty()) return Json();
  const std::size_t dims = bounds.size() / 2;
  if (bounds.size() % 2 != 0)
    return Status(Code::usage,
                  fmt::format("--periodic: a box has two corners, but {} bounds were given", bounds.size()),
                  "--periodic LO... HI..., such as: --periodic 0 0 - 1 1 -");
  for (std::size_t a = 0; a < dims; ++a)
    if ((bounds[a] == kOpen) != (bounds[dims + a] == kOpen))
      return Status(Code::usage, fmt::format("--periodic: an axis from {} to {}", bounds[a], bounds[dims + a]),
                    "- stands for both bounds of an axis, or for none");
  return Json{{"lo", periodic_corner(std::span(bounds).first(dims))},
              {"hi", periodic_corner(std::span(bounds).last(dims))}};
}

Result<Json> near_json(const NearOptions& options) {
  auto periodic = periodic_json(options.periodic);
  if (!periodic) return periodic.status();
  return Json{
      {"scene", options.name}, {"width", options.width}, {"norm", options.norm}, {"periodic", std::move(*periodic)}};
}

std::string near_text(const Json& arguments) {
  std::string text = fmt::format("width {} ({})", text_of(arguments, "width"), text_of(arguments, "norm"));
  if (const Json& periodic = arguments.at("periodic"); !periodic.is_null())
    text += fmt::format(", periodic {} to {}", text_of(periodic, "lo"), text_of(periodic, "hi"));
  return text;
}

std::string axis_name(const Json& axis) {
  const int k = axis.get<int>();
  return k >= 0 && k < 3 ? std::string(1, "xyz"[k]) : text_of(axis);
}

std::string narrowest_text(const Json& reply) {
  const Json narrowest = reply.value("narrowest_region", Json());
  if (!narrowest.is_object()) return "no region has a bound on both sides of an axis, so there is no narrowest width";
  return fmt::format("narrowest region: part {}, {} along {}", text_of(narrowest, "part"), text_of(narrowest, "width"),
                     axis_name(narrowest.at("axis")));
}

}  // namespace rcb::cli
