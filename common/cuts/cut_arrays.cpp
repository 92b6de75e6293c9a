#include "common/cuts/cut_arrays.hpp"

#include <algorithm>
#include <cmath>
#include <span>

#include <fmt/format.h>

#include "common/base/index.hpp"

namespace rcb::cuts {
namespace {

constexpr int kTreePartsMax = 1 << 20;  // as many as a scene may have

Status no_tree(const std::string& why) {
  return {Code::protocol_error, "cuts: " + why, "use a client and a service of the same version"};
}

Status check_sizes(const CutArrays& arrays) {
  if (arrays.dims < 1 || arrays.dims > geometry::kDimsMax) return no_tree(fmt::format("{} dimensions", arrays.dims));
  if (at(static_cast<int>(arrays.method)) >= kMethodNames.size() || !has_cut_tree(arrays.method))
    return no_tree("a method without cuts");
  if (arrays.parts < 1 || arrays.parts > kTreePartsMax) return no_tree(fmt::format("{} parts", arrays.parts));
  const std::size_t cuts = at(arrays.parts) - 1;
  if (arrays.id.size() != cuts || arrays.axes.size() != cuts * at(arrays.dims) ||
      arrays.at.size() != arrays.axes.size())
    return no_tree(fmt::format("arrays of {} axes, {} coordinates and {} ids for {} parts", arrays.axes.size(),
                               arrays.at.size(), arrays.id.size(), arrays.parts));
  const auto& sizes = arrays.part_sizes;
  if (!sizes.empty() && sizes.size() != at(arrays.parts))
    return no_tree(fmt::format("{} part sizes for {} parts", sizes.size(), arrays.parts));
  if (!std::ranges::all_of(sizes, [](double size) { return size > 0 && std::isfinite(size); }))
    return no_tree("a part size that isn't a finite number above 0");
  return {};
}

// Whether the first `axes.size()` axes are these, in some order. Sets `order`; the axes beyond stay last.
bool take_axes(std::span<const std::int32_t> axes, AxisOrder& order) {
  order = {0, 1, 2};
  for (std::size_t i = 0; i < axes.size(); ++i) {
    if (axes[i] < 0 || at(axes[i]) >= axes.size() || std::ranges::count(axes.first(i), axes[i]) > 0) return false;
    order[i] = static_cast<std::int8_t>(axes[i]);
  }
  return true;
}

}  // namespace

CutArrays arrays_of(const CutTree& tree) {
  CutArrays arrays{.dims = tree.dims, .method = tree.method, .parts = tree.parts, .part_sizes = tree.part_sizes};
  for (const Cut& cut : tree.cuts) {
    for (std::size_t i = 0; i < at(tree.dims); ++i) {
      arrays.axes.push_back(cut.axes[i]);
      arrays.at.push_back(cut.right_empty ? 0.0 : cut.key.at[i] + 0.0);
    }
    arrays.id.push_back(cut.right_empty ? -1 : cut.key.id);
  }
  return arrays;
}

Result<CutTree> tree_of(const CutArrays& arrays) {
  if (Status status = check_sizes(arrays); !status) return status;
  CutTree tree;
  tree.dims = arrays.dims;
  tree.method = arrays.method;
  tree.parts = arrays.parts;
  tree.part_sizes = arrays.part_sizes;
  tree.cuts.resize(arrays.id.size());
  const std::size_t dims = at(arrays.dims);
  for (std::size_t k = 0; k < tree.cuts.size(); ++k) {
    Cut& cut = tree.cuts[k];
    if (!take_axes(std::span(arrays.axes).subspan(k * dims, dims), cut.axes))
      return no_tree(fmt::format("the axes of cut {} aren't those of the scene", k));
    cut.right_empty = arrays.id[k] == -1;
    if (arrays.id[k] < -1) return no_tree(fmt::format("id {} of cut {}", arrays.id[k], k));
    if (!cut.right_empty) cut.key.id = arrays.id[k];
    for (std::size_t i = 0; i < dims; ++i) {
      const double x = arrays.at[k * dims + i] + 0.0;  // never -0.0
      if (!std::isfinite(x)) return no_tree(fmt::format("coordinate {} of cut {}", x, k));
      if (!cut.right_empty) cut.key.at[i] = x;
    }
  }
  return tree;
}

}  // namespace rcb::cuts
