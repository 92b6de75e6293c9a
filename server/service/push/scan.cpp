#include "server/service/push/scan.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <span>

#if defined(__x86_64__)
#include <emmintrin.h>
#endif

#include "common/base/check.hpp"
#include "common/layout/layout.hpp"
#include "server/service/push/values.hpp"

namespace rcb::service {
namespace {

using particles::kBlock;
using particles::Range;

constexpr std::size_t kPending = 2048;  // particles classified by the tree at a time; their copies fit in the cache

// The positions of a block of particles, by axis.
struct Chunk {
  std::array<const double*, 3> x;
  std::size_t size;

  std::span<const double> axis(std::size_t a) const { return {x[a], size}; }
};

// Copies of the particles that aren't strictly inside their part's region, to be classified by the tree.
class Pending {
 public:
  Pending(const Scene& scene, const particles::ParticleView& view, Scan& scan)
      : scene_(scene), view_(view), scan_(scan) {}

  // k: the particle's index in its block.
  void add(const Chunk& block, std::size_t k, std::size_t slot) {
    if (slot_.empty()) reserve();
    slot_.push_back(slot);
    for (std::size_t a = 0; a < static_cast<std::size_t>(view_.dims); ++a) position_[a].push_back(block.x[a][k]);
    id_.push_back(view_.id[slot]);
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
      scene_.tree->classify(few, part_.span());
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

  // read(begin, size): the positions of the block of particles that begins there.
  template <typename Read>
  void run_blocks(const Read& read) {
    for (std::size_t a = 0; a < axes(); ++a) scan_.ranges.of[a].resize(particles::blocks_of(view_.count));
    for (std::size_t begin = 0; begin < view_.count; begin += kBlock) {
      const Chunk block{read(begin, size_at(begin)), size_at(begin)};
      if (stays(block, begin)) continue;
      for (std::uint64_t bits = outside(block, part_ + begin); bits != 0; bits &= bits - 1) {
        const auto k = static_cast<std::size_t>(std::countr_zero(bits));
        pending_.add(block, k, begin + k);
      }
    }
    pending_.flush();
  }

 private:
  std::size_t axes() const { return static_cast<std::size_t>(view_.dims); }
  std::size_t size_at(std::size_t begin) const { return std::min(kBlock, view_.count - begin); }

  // True if the block is of one part and strictly within its region. Fills in the block's ranges.
  bool stays(const Chunk& block, std::size_t begin) {
    const std::int32_t* const part = part_ + begin;
    std::int32_t other = 0;
    for (std::size_t i = 0; i < block.size; ++i) other |= part[i] ^ part[0];
    bool inside = other == 0;
    for (std::size_t a = 0; a < axes(); ++a) {
      Range& range = scan_.ranges.of[a][begin / kBlock];
      range = other != 0 ? Range::everything() : particles::range_of(block.axis(a));
      inside = inside && regions_.hold(a, part[0], range);
    }
    return inside;
  }

  std::uint64_t outside(const Chunk& block, const std::int32_t* part) const {
    std::uint64_t bits = 0;
    for (std::size_t a = 0; a < axes(); ++a) bits |= regions_.outside(a, block.axis(a), part);
    return bits;
  }

  const cuts::Regions& regions_;
  const std::int32_t* part_;
  const particles::ParticleView& view_;
  Scan& scan_;
  Pending pending_;
};

// Staged positions of this many bytes aren't in the cache any more when they are next read. They are written past it,
// so that the memory isn't read first, which is a third of the pass's traffic.
constexpr std::size_t kStreamedBytesMin = std::size_t{4} << 20U;

void copy(double* to, const double* from, std::size_t count) { std::memcpy(to, from, count * sizeof(double)); }

#if defined(__x86_64__)
void stream(double* to, const double* from, std::size_t count) {
  std::size_t i = 0;
  if (reinterpret_cast<std::uintptr_t>(to) % sizeof(__m128d) == 0)
    for (; i + 2 <= count; i += 2) _mm_stream_pd(to + i, _mm_loadu_pd(from + i));
  copy(to + i, from + i, count - i);
}
void finish_streams() { _mm_sfence(); }
#else
void stream(double* to, const double* from, std::size_t count) { copy(to, from, count); }
void finish_streams() {}
#endif

// Updates scene.regions, the regions of this rank's parts, if the cuts have changed.
void refresh_regions(Scene& scene, int rank, int ranks) {
  if (scene.regions_epoch == scene.epoch) return;
  const auto [begin, end] = layout::parts_of_rank(rank, scene.options.parts, ranks);
  scene.regions = cuts::Regions(begin, scene.tree->regions(begin, end));
  scene.regions_epoch = scene.epoch;
}

}  // namespace

Scan scan_shared(Scene& scene, const SharedSource& source, particles::ParticleSet& staged, int rank, int ranks) {
  constexpr std::size_t kBlocksAhead = 2;
  Scan scan;
  particles::ParticleView view = staged.view();
  view.count = scene.particles.count();
  view.id = scene.particles.id.data();
  if (view.count == 0) return scan;
  const std::span<const particles::Id> rows = scene.particles.id.span();
  refresh_regions(scene, rank, ranks);
  const auto dims = static_cast<std::size_t>(view.dims);
  const bool streams = view.count * dims * sizeof(double) >= kStreamedBytesMin;
  // A block is read, judged and then staged; it stays in the nearest cache meanwhile.
  std::array<std::array<double, kBlock>, 3> positions;
  Pass(scene, view, scan).run_blocks([&](std::size_t begin, std::size_t size) {
    const std::size_t ahead = std::min(begin + kBlocksAhead * kBlock, rows.size());
    source.prefetch(rows.subspan(ahead, std::min(kBlock, rows.size() - ahead)));
    std::array<const double*, 3> x{};
    for (std::size_t a = 0; a < dims; ++a) {
      source.positions(a, rows.subspan(begin, size), positions[a].data());
      (streams ? stream : copy)(staged.position[a].data() + begin, positions[a].data(), size);
      x[a] = positions[a].data();
    }
    return x;
  });
  if (streams) finish_streams();
  if (view.weight != nullptr) scan.fault |= bad_weights(view.weight, view.count);
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

}  // namespace rcb::service
