// Interface areas, from the cuts alone; ghosts and neighbours are in ghosts.cpp.
#include "common/partition/quality/quality.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "common/base/index.hpp"

namespace rcb::partition {
namespace {

using geometry::Box;

// Sums stay finite.
void add(double& sum, double area) { sum = std::min(sum + area, std::numeric_limits<double>::max()); }

double face(const Box& box, std::size_t axis, std::size_t dims) {
  double area = 1;
  for (std::size_t a = 0; a < dims; ++a)
    if (a != axis) area *= std::min(box.hi[a] - box.lo[a], std::numeric_limits<double>::max());  // infinity * 0: NaN
  return area;
}

// The areas of common faces. A part's share is the area of those faces of its region, clipped to the bounds, that were
// made by cuts.
void measure_interfaces(const CutTree& tree, const Box& bounds, Quality& out) {
  const std::size_t dims = at(tree.dims);
  double all = 0;
  for (const Box& region : tree.regions(0, tree.parts)) {
    Box box = bounds;
    for (std::size_t a = 0; a < dims; ++a) {
      box.lo[a] = std::max(region.lo[a], bounds.lo[a]);
      box.hi[a] = std::min(region.hi[a], bounds.hi[a]);
    }
    double area = 0;
    for (std::size_t a = 0; a < dims && !box.empty(tree.dims); ++a) {
      const double one = face(box, a, dims);
      if (region.lo[a] >= bounds.lo[a]) add(area, one);
      if (region.hi[a] > bounds.hi[a]) continue;
      add(area, one);
      add(all, one);  // as another part's lower face it isn't counted
    }
    out.part_interface_area.push_back(area);
  }
  out.interface_area = all;
}

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
  if (!go_on()) return std::nullopt;
  std::vector<Box> boxes = part_boxes(comm, particles, part, parts);
  Box bounds;
  for (const Box& box : boxes) bounds.extend(box);
  std::uint64_t count = particles.count;
  comm.all_sum({&count, 1});
  const double width = ghost_width ? *ghost_width : default_ghost_width(bounds, count, particles.dims);
  auto counts = count_ghosts(comm, particles, part, std::move(boxes), width, go_on);
  if (!counts) return std::nullopt;
  Quality result{*std::move(counts), width, bounds, {}, {}};
  if (tree != nullptr) measure_interfaces(*tree, bounds, result);
  return result;
}

}  // namespace rcb::partition
