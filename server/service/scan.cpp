#include "server/service/scan.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <span>

#include "common/base/check.hpp"
#include "common/plan/plan.hpp"

namespace rcb::service {
namespace {

using particles::kBlock;
using particles::Range;

constexpr std::size_t kPending = 2048;  // particles that are asked of the tree together; their copies stay in the cache

// Copies of particles that aren't strictly inside their part's region.
class Pending {
 public:
  Pending(const Scene& scene, const particles::ParticleView& view, Scan& scan)
      : scene_(scene), view_(view), scan_(scan) {}

  // i: the particle's place in the view.
  void add(std::size_t i, std::size_t slot) {
    if (slot_.empty()) reserve();
    slot_.push_back(slot);
    for (std::size_t a = 0; a < static_cast<std::size_t>(view_.dims); ++a) position_[a].push_back(view_.position[a][i]);
    id_.push_back(view_.id[i]);
    if (slot_.size() == kPending) flush();
  }

  void flush() {
    if (slot_.empty()) return;
    particles::ParticleView few;
    few.dims = view_.dims;
    few.count = slot_.size();
    few.id = id_.data();
    for (std::size_t a = 0; a < static_cast<std::size_t>(view_.dims); ++a) {
      few.position[a] = position_[a].data();
      for (const double value : position_[a]) scan_.fault |= !std::isfinite(value);
      position_[a].clear();
    }
    if (!scan_.fault) {
      part_.resize(few.count);
      scene_.tree.classify(few, part_.span());
      for (std::size_t k = 0; k < few.count; ++k) {
        if (part_[k] == scene_.part[slot_[k]]) continue;
        scan_.drift.slot.push_back(slot_[k]);
        scan_.drift.part.push_back(part_[k]);
      }
    }
    slot_.clear();
    id_.clear();
  }

 private:
  void reserve() {
    for (std::size_t a = 0; a < static_cast<std::size_t>(view_.dims); ++a) position_[a].reserve(kPending);
    id_.reserve(kPending);
    slot_.reserve(kPending);
  }

  const Scene& scene_;
  const particles::ParticleView& view_;
  Scan& scan_;
  std::array<Buffer<double>, 3> position_;
  Buffer<particles::Id> id_;
  Buffer<std::size_t> slot_;
  Buffer<std::int32_t> part_;
};

template <std::size_t kDims>
bool is_inside(const std::array<const double*, 3>& x, const PartBounds& bounds, std::size_t i) {
  bool inside = true;
  for (std::size_t a = 0; a < kDims; ++a) inside &= (x[a][i] > bounds.lo[a]) & (x[a][i] < bounds.hi[a]);
  return inside;
}

template <std::size_t kDims>
void scan_blocks(const std::array<const double*, 3>& x, std::size_t count, const std::int32_t* part,
                 std::span<const PartBounds> bounds, std::int32_t first, std::span<const std::uint8_t> marks,
                 particles::BlockRanges& ranges, Pending& pending) {
  for (std::size_t begin = 0; begin < count; begin += kBlock) {
    const std::size_t block = begin / kBlock;
    if (!marks.empty() && marks[block] == 0) continue;
    const std::size_t size = std::min(kBlock, count - begin);
    const std::int32_t* const parts = part + begin;
    std::int32_t other = 0;
    for (std::size_t i = 0; i < size; ++i) other |= parts[i] ^ parts[0];
    bool inside = true;
    if (other == 0 && marks.empty()) {
      const PartBounds& of_all = bounds[static_cast<std::size_t>(parts[0] - first)];
      for (std::size_t a = 0; a < kDims; ++a) {
        Range& range = ranges.of[a][block];
        range = particles::range_of({x[a] + begin, size});
        inside &= range.strictly_inside(of_all.lo[a], of_all.hi[a]);
      }
    } else {
      for (std::size_t a = 0; a < kDims && marks.empty(); ++a) ranges.of[a][block] = Range::everything();
      for (std::size_t i = 0; i < size; ++i)
        inside &= is_inside<kDims>(x, bounds[static_cast<std::size_t>(parts[i] - first)], begin + i);
    }
    if (inside) continue;
    for (std::size_t i = begin; i < begin + size; ++i)
      if (!is_inside<kDims>(x, bounds[static_cast<std::size_t>(part[i] - first)], i)) pending.add(i, i);
  }
}

template <std::size_t kDims>
void scan_each(const std::array<const double*, 3>& x, std::span<const std::uint64_t> slots, const std::int32_t* part,
               std::span<const PartBounds> bounds, std::int32_t first, Pending& pending) {
  for (std::size_t k = 0; k < slots.size(); ++k)
    if (!is_inside<kDims>(x, bounds[static_cast<std::size_t>(part[slots[k]] - first)], k)) pending.add(k, slots[k]);
}

bool bad_weights(const double* weight, std::size_t count) {
  std::uint64_t bad = 0;
  for (std::size_t i = 0; i < count; ++i)
    bad += static_cast<std::uint64_t>(!((weight[i] >= 0) & (weight[i] <= std::numeric_limits<double>::max())));
  return bad != 0;
}

}  // namespace

void refresh_bounds(Scene& scene, int rank, int ranks) {
  if (scene.bounds_epoch == scene.epoch) return;
  const std::int64_t begin = plan::part_begin(rank, scene.options.parts, ranks);
  const std::int64_t end = plan::part_begin(rank + 1, scene.options.parts, ranks);
  scene.bounds.resize(static_cast<std::size_t>(end - begin));
  for (std::int64_t p = begin; p < end; ++p) {
    const geometry::Box box = scene.tree.region(static_cast<int>(p));
    scene.bounds[static_cast<std::size_t>(p - begin)] = {box.lo, box.hi};
  }
  scene.bounds_epoch = scene.epoch;
}

Scan scan_positions(Scene& scene, const particles::ParticleView& view, std::span<const std::uint8_t> marks, int rank,
                    int ranks) {
  Scan scan;
  if (view.count == 0) return scan;
  CHECK(marks.empty() || marks.size() == particles::blocks_of(view.count), "a mark a block");
  if (marks.empty())
    for (std::size_t a = 0; a < static_cast<std::size_t>(view.dims); ++a)
      scan.ranges.of[a].resize(particles::blocks_of(view.count));
  refresh_bounds(scene, rank, ranks);
  const auto first = static_cast<std::int32_t>(plan::part_begin(rank, scene.options.parts, ranks));
  Pending pending(scene, view, scan);
  switch (view.dims) {
    case 1:
      scan_blocks<1>(view.position, view.count, scene.part.data(), scene.bounds, first, marks, scan.ranges,
                     pending);
      break;
    case 2:
      scan_blocks<2>(view.position, view.count, scene.part.data(), scene.bounds, first, marks, scan.ranges,
                     pending);
      break;
    default:
      scan_blocks<3>(view.position, view.count, scene.part.data(), scene.bounds, first, marks, scan.ranges,
                     pending);
      break;
  }
  pending.flush();
  if (view.weight != nullptr) scan.fault |= bad_weights(view.weight, view.count);
  return scan;
}

Scan scan_subset(Scene& scene, const particles::ParticleView& view, std::span<const std::uint64_t> slots, int rank,
                 int ranks) {
  Scan scan;
  if (slots.empty()) return scan;
  refresh_bounds(scene, rank, ranks);
  const auto first = static_cast<std::int32_t>(plan::part_begin(rank, scene.options.parts, ranks));
  Pending pending(scene, view, scan);
  if (view.dims == 1)
    scan_each<1>(view.position, slots, scene.part.data(), scene.bounds, first, pending);
  else if (view.dims == 2)
    scan_each<2>(view.position, slots, scene.part.data(), scene.bounds, first, pending);
  else
    scan_each<3>(view.position, slots, scene.part.data(), scene.bounds, first, pending);
  pending.flush();
  return scan;
}

std::vector<std::uint64_t> count_changes(const Scene& scene, const Drift& drift) {
  std::vector<std::uint64_t> change(static_cast<std::size_t>(scene.options.parts), 0);
  for (std::size_t k = 0; k < drift.count(); ++k) {
    --change[static_cast<std::size_t>(scene.part[drift.slot[k]])];
    ++change[static_cast<std::size_t>(drift.part[k])];
  }
  return change;
}

StepSums sum_scans(partition::Comm& comm, const Scene& scene, const Scan& scan, bool fault) {
  const int ranks = comm.size();
  const auto across = static_cast<std::size_t>(ranks);
  const std::size_t pairs = ranks <= StepSums::kRanksMax ? across * across : 0;
  const bool counts = scene.options.parts <= StepSums::kPartsMax && !scene.particles.has_weights;
  std::vector<std::uint64_t> cells(3 + pairs, 0);
  cells[0] = fault ? 1 : 0;
  if (!fault) {
    cells[1] = scan.drift.count();
    for (const std::int32_t part : scan.drift.part) {
      const auto to = static_cast<std::size_t>(plan::rank_of_part(part, scene.options.parts, ranks));
      if (to == static_cast<std::size_t>(comm.rank())) continue;
      ++cells[2];
      if (pairs > 0) ++cells[3 + static_cast<std::size_t>(comm.rank()) * across + to];
    }
  }
  if (counts && !fault) {
    const auto change = count_changes(scene, scan.drift);
    cells.insert(cells.end(), change.begin(), change.end());
  } else if (counts) {
    cells.resize(cells.size() + static_cast<std::size_t>(scene.options.parts), 0);
  }
  comm.all_sum(cells);
  StepSums sums{cells[0], cells[1], cells[2], {}, {}};
  const auto matrix = cells.begin() + 3;
  sums.from_to.assign(matrix, matrix + static_cast<std::ptrdiff_t>(pairs));
  sums.count_change.assign(matrix + static_cast<std::ptrdiff_t>(pairs), cells.end());
  return sums;
}

}  // namespace rcb::service
