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
  equal_boxes,  // halves space, not points: the baseline of `compare`, never a scene's method
  file_order,   // blocks by id: likewise
};

std::string_view method_name(Method method);  // "rcb", "bands-x", ..., "equal-boxes", "file-order"
std::optional<Method> method_from_name(std::string_view name);
// A cut tree describes it, so regions exist and positions have owners.
bool has_cut_tree(Method method);

}  // namespace rcb::partition
