// The names of the methods.
#include "common/partition/tree/method.hpp"

#include <array>
#include <cstddef>

namespace rcb::partition {
namespace {

// Indexed by the enum's values, which the encoding and the hash contain.
constexpr std::array<std::string_view, 6> kNames{"rcb", "bands-x", "bands-y", "bands-z", "equal-boxes", "file-order"};

}  // namespace

std::string_view method_name(Method method) { return kNames[static_cast<std::size_t>(method)]; }

std::optional<Method> method_from_name(std::string_view name) {
  for (std::size_t i = 0; i < kNames.size(); ++i)
    if (kNames[i] == name) return static_cast<Method>(i);
  return std::nullopt;
}

bool has_cut_tree(Method method) { return method != Method::file_order; }

std::optional<int> band_axis(Method method) {
  if (method < Method::bands_x || method > Method::bands_z) return std::nullopt;
  return static_cast<int>(method) - static_cast<int>(Method::bands_x);
}

}  // namespace rcb::partition
