// The partitioning methods by name.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <optional>
#include <string_view>

namespace rcb::cuts {

enum class Method {
  rcb,
  bands_x,
  bands_y,
  bands_z,
  equal_boxes,  // halves space, not particles: a baseline of `compare`, never a scene's method
  file_order,   // blocks of ids: a baseline too
};

// Indexed by the enum's values, which the encoding and the hash contain.
inline constexpr std::array<std::string_view, 6> kMethodNames{"rcb",     "bands-x",     "bands-y",
                                                              "bands-z", "equal-boxes", "file-order"};

constexpr std::string_view method_name(Method method) { return kMethodNames[static_cast<std::size_t>(method)]; }
constexpr std::optional<Method> method_from_name(std::string_view name) {
  const auto* const found = std::ranges::find(kMethodNames, name);
  return found == kMethodNames.end() ? std::nullopt : std::optional(static_cast<Method>(found - kMethodNames.begin()));
}
// True if a cut tree describes the method's partitions, so that parts have regions and positions have owners.
constexpr bool has_cut_tree(Method method) { return method != Method::file_order; }
// The axis that bands lie along.
constexpr std::optional<int> band_axis(Method method) {
  if (method < Method::bands_x || method > Method::bands_z) return std::nullopt;
  return static_cast<int>(method) - static_cast<int>(Method::bands_x);
}

}  // namespace rcb::cuts
