// Interface areas, from the cuts alone; ghosts and neighbours are in ghosts.cpp.
#include "common/partition/quality/quality.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "common/base/index.hpp"
#include "common/partition/balance/bounding_box.hpp"

namespace rcb::partition {
namespace {

using geometry::Box;

// The areas of common faces. Each lies on one cut; a part's share is the area of those faces of its clipped region that
// were made by cuts.
class Interfaces {
 public:
  Interfaces(const CutTree& tree, const Box& bounds, Quality& out) : tree_(tree), dims_(at(tree.dims)), out_(out) {
    out_.interface_area = 0.0;
    out_.part_interface_area.assign(at(tree.parts), 0.0);
    if (!bounds.empty(tree.dims)) visit(tree.root(), bounds, Sides{});
  }

 private:
  struct Sides {  // true: this side of a box was made by a cut
    std::array<bool, geometry::kDimsMax> lo{};
    std::array<bool, geometry::kDimsMax> hi{};
  };

  // Sums stay finite, as a face does.
  static void add(double& sum, double area) { sum = std::min(sum + area, std::numeric_limits<double>::max()); }
  double face(const Box& box, std::size_t axis) const {
    double area = 1;
    for (std::size_t a = 0; a < dims_; ++a)
      if (a != axis) area *= std::min(box.hi[a] - box.lo[a], std::numeric_limits<double>::max());
    return std::min(area, std::numeric_limits<double>::max());  // kept finite, since infinity times 0 sides is NaN
  }
  void visit(const NodeRange& range, const Box& box, const Sides& sides) {
    if (range.leaf()) {
      for (std::size_t a = 0; a < dims_; ++a)
        add(out_.part_interface_area[at(range.first)], face(box, a) * (static_cast<int>(sides.lo[a]) + sides.hi[a]));
      return;
    }
    const Cut& cut = tree_.cuts[at(range.node)];
    const auto axis = static_cast<std::size_t>(cut.axes[0]);
    const double value = cut.key.at[0];
    // A cut outside the bounds leaves one side without a region.
    if (cut.right_empty || value > box.hi[axis]) return visit(range.left(), box, sides);
    if (value < box.lo[axis]) return visit(range.right(), box, sides);
    add(*out_.interface_area, face(box, axis));
    Box left = box;
    Box right = box;
    left.hi[axis] = right.lo[axis] = value;
    Sides left_sides = sides;
    Sides right_sides = sides;
    left_sides.hi[axis] = right_sides.lo[axis] = true;
    visit(range.left(), left, left_sides);
    visit(range.right(), right, right_sides);
  }

  const CutTree& tree_;
  std::size_t dims_;
  Quality& out_;
};

}  // namespace

double default_ghost_width(const Box& bounds, std::uint64_t n, int dims) {
  if (n == 0 || bounds.empty(dims)) return 0;
  int axes = 0;
  double volume = 1;
  double log_volume = 0;  // for a product outside of a double's range
  for (std::size_t a = 0; a < at(dims); ++a) {
    const double half = geometry::extent(bounds.lo[a], bounds.hi[a]);
    if (!(half > 0)) continue;
    ++axes;
    volume *= 2 * half;
    log_volume += std::log(half) + std::log(2.0);
  }
  if (axes == 0) return 0;
  const auto count = static_cast<double>(n);
  if (std::isfinite(volume) && volume / count > std::numeric_limits<double>::min())
    return 2 * std::pow(volume / count, 1.0 / axes);
  return std::min(2 * std::exp((log_volume - std::log(count)) / axes), std::numeric_limits<double>::max());
}

std::optional<Quality> quality(comm::Comm& comm, const particles::ParticleView& particles,
                               std::span<const std::int32_t> part, int parts, const CutTree* tree,
                               std::optional<double> ghost_width, const comm::GoOn& go_on) {
  const Box bounds = bounding_box(comm, particles);
  std::uint64_t count = particles.count;
  comm.all_sum({&count, 1});
  const double width = ghost_width ? *ghost_width : default_ghost_width(bounds, count, particles.dims);
  auto counts = count_ghosts(comm, particles, part, parts, width, go_on);
  if (!counts) return std::nullopt;
  Quality result{*std::move(counts), width, bounds, {}, {}};
  if (tree != nullptr) Interfaces(*tree, result.bounds, result);
  return result;
}

}  // namespace rcb::partition
