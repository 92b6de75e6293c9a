// The entry point: it checks the options and makes the trees that need no search; search_all.cpp makes the others.
#include "common/partition/partition.hpp"

#include <algorithm>
#include <cmath>

#include "common/partition/balance/bounds.hpp"
#include "common/partition/search/tree_search.hpp"
#include "common/partition/search_all.hpp"

namespace rcb::partition {
namespace {

Status check(const PartitionOptions& options, int dims) {
  const auto bad = [](std::string message, std::string hint) {
    return Status(Code::invalid_argument, std::move(message), std::move(hint));
  };
  if (dims < 1 || dims > geometry::kDimsMax)
    return bad("dims is " + std::to_string(dims), "positions have 1, 2 or 3 dimensions");
  if (options.parts < 1) return bad("parts is " + std::to_string(options.parts), "give 1 or more");
  const auto& sizes = options.part_sizes;
  if (!sizes.empty() && sizes.size() != static_cast<std::size_t>(options.parts))
    return bad(std::to_string(sizes.size()) + " part sizes for " + std::to_string(options.parts) + " parts",
               "give one size for each part");
  for (std::size_t p = 0; p < sizes.size(); ++p)
    if (!std::isfinite(sizes[p]) || !(sizes[p] > 0))
      return bad("the size of part " + std::to_string(p) + " is not a finite number > 0", "sizes are relative shares");
  if (!std::isfinite(options.axis_hysteresis) || !(options.axis_hysteresis >= 1))
    return bad("axis_hysteresis is not a finite number >= 1", "1 follows the extents alone");
  if (!std::isfinite(options.cut_tolerance) || !(options.cut_tolerance >= 0))
    return bad("cut_tolerance is not a finite number >= 0", "0 gives exact cuts");
  if (band_axis(options.method).value_or(0) >= dims)
    return bad(std::string(method_name(options.method)) + " needs an axis that " + std::to_string(dims) +
                   "-dimensional positions lack",
               "choose rcb or bands-x");
  return {};
}

// The tree of equal boxes: every box is halved at lo/2 + hi/2 across its longest side.
void halve(CutTree& tree, const NodeRange& range, const Point& lo, const Point& hi) {
  if (range.leaf()) return;
  Point extents{};
  for (std::size_t a = 0; a < static_cast<std::size_t>(tree.dims); ++a) extents[a] = geometry::extent(lo[a], hi[a]);
  Cut& cut = tree.cuts[static_cast<std::size_t>(range.node)];
  cut.axes = geometry::order_by_extent(extents, tree.dims);
  const auto axis = static_cast<std::size_t>(cut.axes[0]);
  const double middle = lo[axis] * 0.5 + hi[axis] * 0.5 + 0.0;
  cut.key = key_between(middle, tree.dims);  // coordinates equal to the middle go right
  Point left_hi = hi;
  Point right_lo = lo;
  left_hi[axis] = right_lo[axis] = middle;
  halve(tree, range.left(), lo, left_hi);
  halve(tree, range.right(), right_lo, hi);
}

Status given_up() { return {Code::aborted, "the partition was given up"}; }

Result<PartitionResult> equal_boxes(comm::Comm& comm, const particles::ParticleView& particles,
                                    const PartitionOptions& options, const comm::GoOn& go_on) {
  PartitionResult result;
  result.tree = uncut_tree(options, particles.dims);
  const geometry::Box box = bounding_box(comm, particles);
  ++result.cost.reductions;
  if (box.empty(particles.dims)) {
    for (Cut& cut : result.tree.cuts) cut.right_empty = true;
  } else {
    halve(result.tree, result.tree.root(), box.lo, box.hi);
  }
  if (go_on && !go_on()) return given_up();
  result.part.resize(particles.count);
  result.tree.classify(particles, result.part.span());
  return result;
}

// Where all particles lie in one place, ids alone divide them.
Result<PartitionResult> file_order(comm::Comm& comm, const particles::ParticleView& particles,
                                   const PartitionOptions& options, const comm::GoOn& go_on) {
  Buffer<double> place(particles.count);
  std::fill(place.begin(), place.end(), 0.0);
  particles::ParticleView in_one_place = particles;
  in_one_place.dims = 1;
  in_one_place.position = {place.data()};
  in_one_place.weight = nullptr;
  const PartitionOptions by_id{.parts = options.parts, .part_sizes = options.part_sizes, .tuning = options.tuning};
  auto result = search_all(comm, in_one_place, by_id, go_on);
  if (!result) return given_up();
  result->tree = CutTree{};
  return *std::move(result);
}

}  // namespace

Result<PartitionResult> partition(comm::Comm& comm, const particles::ParticleView& particles,
                                  const PartitionOptions& options, const comm::GoOn& go_on) {
  if (Status status = check(options, particles.dims); !status.ok()) return status;
  if (options.method == Method::equal_boxes) return equal_boxes(comm, particles, options, go_on);
  if (options.method == Method::file_order) return file_order(comm, particles, options, go_on);
  if (auto result = search_all(comm, particles, options, go_on)) return *std::move(result);
  return given_up();
}

}  // namespace rcb::partition
