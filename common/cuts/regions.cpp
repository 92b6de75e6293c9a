#include "common/cuts/regions.hpp"

#include <algorithm>

#include "common/cuts/kernels.hpp"

namespace rcb::cuts {

Regions::Regions(std::int32_t first_part, std::span<const geometry::Box> boxes)
    : first_part_(first_part), parts_(boxes.size()) {
  constexpr std::size_t kRoom = 8;  // as a kernel wants
  for (std::size_t a = 0; a < geometry::kDimsMax; ++a) {
    lo_[a].assign(std::max(parts_, kRoom), 0);
    hi_[a].assign(std::max(parts_, kRoom), 0);
    for (std::size_t p = 0; p < parts_; ++p) {
      lo_[a][p] = boxes[p].lo[a];
      hi_[a][p] = boxes[p].hi[a];
    }
  }
}

std::uint64_t Regions::outside(std::size_t axis, std::span<const double> values, const std::int32_t* part) const {
  return kernels().outside_own(values, part, {lo_[axis].data(), hi_[axis].data(), parts_, first_part_});
}

std::uint64_t outside_of(const particles::Axes& x, std::size_t count, const geometry::Box& box) {
  return kernels().outside(x, count, box);
}

}  // namespace rcb::cuts
