#include "common/cuts/reach.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "common/base/axis_names.hpp"

namespace rcb::cuts {
namespace {

using geometry::Box;

std::vector<Box> bounded_by(std::span<const Box> regions, int dims, const PeriodicBox& box) {
  std::vector<Box> bounded(regions.begin(), regions.end());
  for (Box& region : bounded) {
    if (region.empty(dims)) continue;
    for (std::size_t a = 0; a < at(dims); ++a) {
      if (!box.periodic(a)) continue;
      if (std::isinf(region.lo[a])) region.lo[a] = box.lo[a];
      if (std::isinf(region.hi[a])) region.hi[a] = box.hi[a];
    }
  }
  return bounded;
}

// The largest distance along an axis that Within(norm, width) accepts, or a little more: a square may be rounded to 0.
double farthest(Norm norm, double width) {
  if (norm == Norm::max) return width;
  return std::max(width * (1 + 4 * std::numeric_limits<double>::epsilon()), 2e-154);
}

Status too_many_images(double width) {
  return {Code::invalid_argument,
          fmt::format("width {}: more than {} periodic images come near, or one from more than 2^31 periods away",
                      width, Reach::kImagesMax),
          "give a smaller width or a larger periodic box, and positions near it"};
}

}  // namespace

Status Near::check(int dims) const {
  if (!(width >= 0) || std::isinf(width))
    return {Code::invalid_argument, fmt::format("a width of {}", width), "give a finite number >= 0"};
  if (norm == Norm::euclid && std::isinf(width * width))
    return {Code::invalid_argument, fmt::format("a width of {}", width), "its square must be a finite number, too"};
  for (std::size_t a = 0; a < at(dims); ++a) {
    const bool open = std::isinf(box.lo[a]) && std::isinf(box.hi[a]);
    if (!open && (!box.periodic(a) || !(box.lo[a] < box.hi[a]) || std::isinf(box.length(a))))
      return {Code::invalid_argument,
              fmt::format("periodic box: {} from {} to {}", kAxisNames[a], box.lo[a], box.hi[a]),
              "lo must be below hi, both finite; an axis that isn't periodic has no bounds"};
  }
  return {};
}

Reach::Reach(std::span<const Box> regions, int dims, const Near& near)
    : dims_(dims), near_(near), tree_(bounded_by(regions, dims, near.box), dims) {
  for (const Box& box : tree_.leaves()) bounds_.push_back({Within::Lanes(box.lo), Within::Lanes(box.hi)});
}

Status Reach::images_of(const Box& box, double width, std::vector<Image>& images) const {
  const Within within(near_.norm, width);
  const double far = farthest(near_.norm, width);
  const Box around = tree_.around();
  std::array<std::vector<std::int32_t>, geometry::kDimsMax> ks;
  std::size_t count = 1;
  for (std::size_t a = 0; a < geometry::kDimsMax; ++a) {
    if (a >= at(dims_) || !near_.box.periodic(a)) {
      ks[a] = {0};
      continue;
    }
    const double length = near_.box.length(a);
    const double first = std::floor((around.lo[a] - far - box.hi[a]) / length) - 1;
    const double last = std::ceil((around.hi[a] + far - box.lo[a]) / length) + 1;
    constexpr double kMost = std::numeric_limits<std::int32_t>::max();
    if (!(first > -kMost && last < kMost && last - first < kImagesMax)) return too_many_images(width);
    for (auto k = static_cast<std::int32_t>(first); k <= static_cast<std::int32_t>(last); ++k) {
      const double by = k * length;
      if (within(gap_of(around, a, box.lo[a] + by, box.hi[a] + by))) ks[a].push_back(k);
    }
    count *= ks[a].size();
    if (count > kImagesMax) return too_many_images(width);
  }
  images.clear();
  for (const std::int32_t x : ks[0])
    for (const std::int32_t y : ks[1])
      for (const std::int32_t z : ks[2]) {
        Image image{{x, y, z}, {}};
        for (std::size_t a = 0; a < at(dims_); ++a)
          if (image.k[a] != 0) image.by[a] = image.k[a] * near_.box.length(a);
        images.push_back(image);
      }
  return {};
}

Box Reach::finite(Box box) {
  constexpr double kMost = std::numeric_limits<double>::max();
  for (std::size_t a = 0; a < geometry::kDimsMax; ++a) {
    box.lo[a] = std::clamp(box.lo[a], -kMost, kMost);
    box.hi[a] = std::clamp(box.hi[a], -kMost, kMost);
  }
  return box;
}

}  // namespace rcb::cuts
