#include "server/service/push/arrays.hpp"

#include <algorithm>

#include <fmt/format.h>

#include "common/base/axis_names.hpp"

namespace rcb::service {

ArrayTypes axes_of(const Scene& scene) {
  ArrayTypes types;
  for (int a = 0; a < scene.options.dims; ++a) types.emplace_back(kAxisNames[a], "<f8");
  return types;
}

ArrayTypes arrays_of(const Scene& scene, const PushRequest& push) {
  ArrayTypes types = axes_of(scene);
  if (push.weights) types.emplace_back("w", "<f8");
  if (push.ids) types.emplace_back("id", "<i8");
  return types;
}

ArrayTypes arrays_of_few(const Scene& scene) {
  ArrayTypes types = axes_of(scene);
  types.emplace_back("slot", "<u8");
  return types;
}

Status check_arrays(const PushSlice& slice, const std::string& what, std::uint64_t count, const ArrayTypes& types) {
  bool match = slice.count == count && slice.arrays.size() == types.size();
  for (std::size_t a = 0; match && a < types.size(); ++a) {
    const wire::Array& array = slice.arrays[a];
    match = array.name == types[a].first && array.dtype == types[a].second &&
            array.shape == std::vector<std::uint64_t>{count} && array.bytes.size() == count * 8;
  }
  if (match) return {};
  std::string names;
  for (const auto& [name, dtype] : types) names += fmt::format("{}{} {}", names.empty() ? "" : ", ", name, dtype);
  return {Code::invalid_argument, fmt::format("the {} must be {} particles with the arrays {}", what, count, names)};
}

PushSlice take_slice(std::vector<PushSlice>& slices, int rank) {
  const auto found = std::find_if(slices.begin(), slices.end(), [rank](const auto& s) { return s.rank == rank; });
  PushSlice slice;
  if (found == slices.end()) return slice;
  slice = std::move(*found);
  slices.erase(found);
  return slice;
}

}  // namespace rcb::service
