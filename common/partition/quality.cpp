// Ghosts and neighbours by a tree of the parts' bounding boxes; interface areas from the cuts alone.
#include "common/partition/quality.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "common/base/check.hpp"
#include "common/partition/partition.hpp"

namespace rcb::partition {
namespace {

using geometry::Box;

constexpr std::uint64_t kNone = ~std::uint64_t{0};

std::size_t at(int index) { return static_cast<std::size_t>(index); }

// The bounding box of each part's particles, on all ranks; empty for a part without any. Collective.
std::vector<Box> part_boxes(Comm& comm, const particles::ParticleView& particles, std::span<const std::int32_t> part,
                            int parts) {
  std::vector<Box> boxes(at(parts));
  for (std::size_t i = 0; i < particles.count; ++i) boxes[at(part[i])].extend(particles.point(i), particles.dims);
  const auto dims = at(particles.dims);
  std::vector<std::uint64_t> least(boxes.size() * dims * 2, kNone);
  for (std::size_t p = 0; p < boxes.size(); ++p)
    for (std::size_t a = 0; a < dims && !boxes[p].empty(particles.dims); ++a) {
      least[(p * dims + a) * 2] = geometry::image(boxes[p].lo[a]);
      least[(p * dims + a) * 2 + 1] = ~geometry::image(boxes[p].hi[a]);
    }
  comm.all_min(least);
  for (std::size_t p = 0; p < boxes.size(); ++p)
    for (std::size_t a = 0; a < dims && least[p * dims * 2] != kNone; ++a) {
      boxes[p].lo[a] = geometry::value_of_image(least[(p * dims + a) * 2]);
      boxes[p].hi[a] = geometry::value_of_image(~least[(p * dims + a) * 2 + 1]);
    }
  return boxes;
}

// The boxes of all nodes of the tree of parts (the numbering of NodeRange), so that a point finds the boxes near it
// without a look at all.
class BoxTree {
 public:
  BoxTree(std::vector<Box> leaves, int dims, double width)
      : leaves_(std::move(leaves)), inner_(leaves_.size()), dims_(at(dims)), width_(width) {
    build({0, 0, static_cast<int>(leaves_.size())});
  }
  // Calls visit(part) for each part whose box is within `width` of the point, in the maximum norm.
  template <typename Visit>
  void near(const Point& point, const Visit& visit) const {
    descend({0, 0, static_cast<int>(leaves_.size())}, point, visit);
  }

 private:
  const Box& build(const NodeRange& range) {
    if (range.leaf()) return leaves_[at(range.first)];
    const Box left = build(range.left());
    const Box right = build(range.right());
    Box& box = inner_[at(range.node)];
    box = left;
    box.extend(right);
    return box;
  }
  template <typename Visit>
  void descend(const NodeRange& range, const Point& point, const Visit& visit) const {
    const Box& box = range.leaf() ? leaves_[at(range.first)] : inner_[at(range.node)];
    for (std::size_t a = 0; a < dims_; ++a)
      if (box.lo[a] > box.hi[a] || box.lo[a] - point[a] > width_ || point[a] - box.hi[a] > width_) return;
    if (range.leaf()) return visit(range.first);
    descend(range.left(), point, visit);
    descend(range.right(), point, visit);
  }

  std::vector<Box> leaves_;
  std::vector<Box> inner_;
  std::size_t dims_;
  double width_;
};

// The local particles' rows by part.
struct ByPart {
  std::vector<std::size_t> start;  // of each part, and the end
  std::vector<std::size_t> row;
};

ByPart group(std::span<const std::int32_t> part, int parts) {
  ByPart by;
  by.start.assign(at(parts) + 1, 0);
  for (const std::int32_t p : part) ++by.start[at(p) + 1];
  for (std::size_t p = 0; p < at(parts); ++p) by.start[p + 1] += by.start[p];
  by.row.resize(part.size());
  std::vector<std::size_t> next(by.start.begin(), by.start.end() - 1);
  for (std::size_t i = 0; i < part.size(); ++i) by.row[next[at(part[i])]++] = i;
  return by;
}

// Number of distinct owners of each part's ghosts, from the pairs part * parts + owner that any rank saw. Collective.
std::vector<std::int32_t> count_neighbours(Comm& comm, const std::vector<std::uint64_t>& pairs, int parts) {
  std::vector<std::byte> bytes;
  std::vector<std::size_t> sizes;
  comm.all_gather(std::as_bytes(std::span(pairs)), bytes, sizes);
  std::vector<std::uint64_t> all(bytes.size() / sizeof(std::uint64_t));
  if (!bytes.empty()) std::memcpy(all.data(), bytes.data(), bytes.size());
  std::ranges::sort(all);
  const auto repeated = std::ranges::unique(all);
  all.erase(repeated.begin(), repeated.end());
  std::vector<std::int32_t> neighbours(at(parts), 0);
  for (const std::uint64_t pair : all) ++neighbours[pair / static_cast<std::uint64_t>(parts)];
  return neighbours;
}

// Common faces. Every face lies on one cut; a part's face on it is the side of its clipped region that the cut made.
class Interfaces {
 public:
  Interfaces(const CutTree& tree, const Box& bounds, Quality& out) : tree_(tree), dims_(at(tree.dims)), out_(out) {
    out_.interface_area = 0.0;
    out_.part_interface_area.assign(at(tree.parts), 0.0);
    if (!bounds.empty(tree.dims)) visit(tree.root(), bounds, Sides{});
  }

 private:
  struct Sides {  // made by a cut
    std::array<bool, geometry::kDimsMax> lo{};
    std::array<bool, geometry::kDimsMax> hi{};
  };

  double face(const Box& box, std::size_t axis) const {
    double area = 1;
    for (std::size_t a = 0; a < dims_; ++a)
      if (a != axis) area *= std::min(box.hi[a] - box.lo[a], std::numeric_limits<double>::max());
    return area;
  }
  void visit(const NodeRange& range, const Box& box, const Sides& sides) {
    if (range.leaf()) {
      for (std::size_t a = 0; a < dims_; ++a)
        out_.part_interface_area[at(range.first)] += face(box, a) * (static_cast<int>(sides.lo[a]) + sides.hi[a]);
      return;
    }
    const Cut& cut = tree_.cuts[at(range.node)];
    const auto axis = static_cast<std::size_t>(cut.axes[0]);
    const double value = cut.key.at[0];
    // A cut outside the bounds leaves one side without a region.
    if (cut.right_empty || value > box.hi[axis]) return visit(range.left(), box, sides);
    if (value < box.lo[axis]) return visit(range.right(), box, sides);
    *out_.interface_area += face(box, axis);
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
  double log_volume = 0;  // where the product would leave the range of a double
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

Quality quality(Comm& comm, const particles::ParticleView& particles, std::span<const std::int32_t> part, int parts,
                const CutTree* tree, std::optional<double> ghost_width) {
  CHECK(part.size() == particles.count && parts >= 1, "a part for each particle");
  Quality result;
  result.bounds = bounding_box(comm, particles);
  std::uint64_t count = particles.count;
  comm.all_sum({&count, 1});
  result.ghost_width = ghost_width ? *ghost_width : default_ghost_width(result.bounds, count, particles.dims);
  const BoxTree boxes(part_boxes(comm, particles, part, parts), particles.dims, result.ghost_width);

  result.ghosts.assign(at(parts), 0);
  std::vector<std::uint64_t> pairs;
  std::vector<std::int32_t> last_owner(at(parts), -1);  // a pair is noted once
  const ByPart by = group(part, parts);
  for (int owner = 0; owner < parts; ++owner)
    for (std::size_t k = by.start[at(owner)]; k < by.start[at(owner) + 1]; ++k)
      boxes.near(particles.point(by.row[k]), [&](int p) {
        if (p == owner) return;
        ++result.ghosts[at(p)];
        if (last_owner[at(p)] == owner) return;
        last_owner[at(p)] = owner;
        pairs.push_back(static_cast<std::uint64_t>(p) * static_cast<std::uint64_t>(parts) +
                        static_cast<std::uint64_t>(owner));
      });
  comm.all_sum(result.ghosts);
  result.neighbours = count_neighbours(comm, pairs, parts);
  if (tree != nullptr) Interfaces(*tree, result.bounds, result);
  return result;
}

}  // namespace rcb::partition
