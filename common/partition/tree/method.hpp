// The partitioning methods by name.
#pragma once

#include <optional>
#include <string_view>

namespace rcb::partition {

enum class Method {
  rcb,
  bands_x,
  bands_y,
  bands_z,
  equal_boxes,  // halves space, not particles: a baseline of `compare`, never a scene's method
  file_order,   // blocks of ids: a baseline too
};

std::string_view method_name(Method method);  // "rcb", "bands-x", ..., "equal-boxes", "file-order"
std::optional<Method> method_from_name(std::string_view name);
// True if a cut tree describes the method's partitions, so that parts have regions and positions have owners.
bool has_cut_tree(Method method);
// The axis that bands lie along.
std::optional<int> band_axis(Method method);

}  // namespace rcb::partition
