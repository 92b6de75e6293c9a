#include "server/service/scan.hpp"

#include <algorithm>
#include <bit>
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

class Pass {
 public:
  Pass(const Scene& scene, const particles::ParticleView& view, Scan& scan)
      : regions_(scene.regions), part_(scene.part.data()), view_(view), scan_(scan), pending_(scene, view, scan) {}

  void run_blocks(std::span<const std::uint8_t> marks) {
    if (marks.empty())
      for (std::size_t a = 0; a < axes(); ++a) scan_.ranges.of[a].resize(particles::blocks_of(view_.count));
    for (std::size_t begin = 0; begin < view_.count; begin += kBlock) {
      if (marks.empty() ? stays(begin) : marks[begin / kBlock] == 0) continue;
      for (std::uint64_t bits = outside(begin, part_ + begin); bits != 0; bits &= bits - 1) {
        const std::size_t i = begin + static_cast<std::size_t>(std::countr_zero(bits));
        pending_.add(i, i);
      }
    }
    pending_.flush();
  }

  void run_each(std::span<const std::uint64_t> slots) {
    std::array<std::int32_t, kBlock> part;
    for (std::size_t begin = 0; begin < view_.count; begin += kBlock) {
      for (std::size_t k = 0; k < size_at(begin); ++k) part[k] = part_[slots[begin + k]];
      for (std::uint64_t bits = outside(begin, part.data()); bits != 0; bits &= bits - 1) {
        const std::size_t k = begin + static_cast<std::size_t>(std::countr_zero(bits));
        pending_.add(k, slots[k]);
      }
    }
    pending_.flush();
  }

 private:
  std::size_t axes() const { return static_cast<std::size_t>(view_.dims); }
  std::size_t size_at(std::size_t begin) const { return std::min(kBlock, view_.count - begin); }
  std::span<const double> values(std::size_t axis, std::size_t begin) const {
    return {view_.position[axis] + begin, size_at(begin)};
  }

  // Whether the block is of one part and within its region. Makes its ranges.
  bool stays(std::size_t begin) {
    const std::int32_t* const part = part_ + begin;
    std::int32_t other = 0;
    for (std::size_t i = 0; i < size_at(begin); ++i) other |= part[i] ^ part[0];
    bool inside = other == 0;
    for (std::size_t a = 0; a < axes(); ++a) {
      Range& range = scan_.ranges.of[a][begin / kBlock];
      range = other == 0 ? particles::range_of(values(a, begin)) : Range::everything();
      inside = inside && regions_.hold(a, part[0], range);
    }
    return inside;
  }

  std::uint64_t outside(std::size_t begin, const std::int32_t* part) const {
    std::uint64_t bits = 0;
    for (std::size_t a = 0; a < axes(); ++a) bits |= regions_.outside(a, values(a, begin), part);
    return bits;
  }

  const Regions& regions_;
  const std::int32_t* part_;
  const particles::ParticleView& view_;
  Scan& scan_;
  Pending pending_;
};

bool bad_weights(const double* weight, std::size_t count) {
  std::uint64_t bad = 0;
  for (std::size_t i = 0; i < count; ++i)
    bad += static_cast<std::uint64_t>(!((weight[i] >= 0) & (weight[i] <= std::numeric_limits<double>::max())));
  return bad != 0;
}

}  // namespace

void refresh_regions(Scene& scene, int rank, int ranks) {
  if (scene.regions_epoch == scene.epoch) return;
  const std::int64_t begin = plan::part_begin(rank, scene.options.parts, ranks);
  const std::int64_t end = plan::part_begin(rank + 1, scene.options.parts, ranks);
  std::vector<geometry::Box> boxes;
  for (std::int64_t p = begin; p < end; ++p) boxes.push_back(scene.tree.region(static_cast<int>(p)));
  scene.regions = Regions(static_cast<std::int32_t>(begin), boxes);
  scene.regions_epoch = scene.epoch;
}

Scan scan_positions(Scene& scene, const particles::ParticleView& view, std::span<const std::uint8_t> marks, int rank,
                    int ranks) {
  Scan scan;
  if (view.count == 0) return scan;
  CHECK(marks.empty() || marks.size() == particles::blocks_of(view.count), "a mark a block");
  refresh_regions(scene, rank, ranks);
  Pass(scene, view, scan).run_blocks(marks);
  if (view.weight != nullptr) scan.fault |= bad_weights(view.weight, view.count);
  return scan;
}

Scan scan_subset(Scene& scene, const particles::ParticleView& view, std::span<const std::uint64_t> slots, int rank,
                 int ranks) {
  Scan scan;
  if (slots.empty()) return scan;
  refresh_regions(scene, rank, ranks);
  Pass(scene, view, scan).run_each(slots);
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
