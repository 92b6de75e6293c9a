// Reach: which regions an image of a box, or of a point, comes near.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/base/status.hpp"
#include "common/cuts/box_tree.hpp"
#include "common/cuts/periodic.hpp"

namespace rcb::cuts {

struct Image {
  Shift k{};
  Point by{};  // k * length, rounded

  geometry::Box of(const geometry::Box& box) const {
    geometry::Box moved;
    for (std::size_t a = 0; a < geometry::kDimsMax; ++a) {
      moved.lo[a] = box.lo[a] + by[a];
      moved.hi[a] = box.hi[a] + by[a];
    }
    return moved;
  }
};

class Reach {
 public:
  static constexpr std::size_t kImagesMax = 65536;  // of one box

  // near: has been checked. Along periodic axes its box takes the place of bounds that regions don't have.
  Reach(std::span<const geometry::Box> regions, int dims, const Near& near);

  int dims() const { return dims_; }
  const Near& near() const { return near_; }
  const geometry::Box& region(int part) const { return tree_.leaves()[at(part)]; }
  const Within::Bounds& bounds(int part) const { return bounds_[at(part)]; }

  // The images of `box` that may come within `width` of any region, ascending by k. Errors: invalid_argument (more than
  // kImagesMax, or k beyond 2^31).
  Status images_of(const geometry::Box& box, double width, std::vector<Image>& images) const;

  // The box with the greatest numbers as bounds where it has none.
  static geometry::Box finite(geometry::Box box);

  // Calls visit(part) for the regions within the width of the box; ascending. Bounds at infinity may be near others.
  template <typename Visit>
  void near(const geometry::Box& box, const Within& within, const Visit& visit) const {
    tree_.near(finite(box), within, [&visit](int first, int last) {
      for (int part = first; part < last; ++part) visit(part);
    });
  }

 private:
  int dims_;
  Near near_;
  BoxTree tree_;
  std::vector<Within::Bounds> bounds_;  // of the regions, for many tests
};

}  // namespace rcb::cuts
