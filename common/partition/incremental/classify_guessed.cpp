#include "common/partition/incremental/classify_guessed.hpp"

#include <algorithm>
#include <array>
#include <bit>

#include "common/base/index.hpp"
#include "common/partition/incremental/find_leaves.hpp"

namespace rcb::partition {
namespace {

using particles::kBlock;

class GuessedPass {
 public:
  GuessedPass(const particles::ParticleView& particles, const Guess& guess, std::span<const NodeRange> roots,
              std::span<std::int32_t> part, std::size_t boundary_max, OwnInterior& out)
      : particles_(particles),
        part_(part),
        boundary_max_(boundary_max),
        tables_(guess, roots, particles.dims),
        out_(out),
        boundary_(out) {}

  void run() {
    const Axes x = axes_of(particles_);
    std::size_t begin = 0;
    for (; begin < particles_.count && boundary_.size() <= boundary_max_; begin += kBlock) {
      const std::size_t count = std::min(kBlock, particles_.count - begin);
      run_block({x[0] + begin, x[1] + begin, x[2] + begin}, begin, count);
    }
    // If it stopped early, the result will not be used, but the rest of `part` must be valid parts all the same. With
    // several roots they are.
    for (std::size_t i = begin; i < particles_.count && !tables_.several; ++i) part_[i] = 0;
    boundary_.finish();
    for (std::size_t leaf = 0; leaf < tables_.leaves; ++leaf) {
      out_.boxes[at(tables_.part[leaf])] = tables_.box[leaf];
      out_.counts[at(tables_.part[leaf])] = counts_[leaf];
    }
  }

 private:
  std::size_t axes() const { return at(particles_.dims); }

  void run_block(const Axes& x, std::size_t begin, std::size_t count) {
    std::int32_t* const part = part_.data() + begin;
    FoundLeaves found = find_leaves(tables_, x, part, count, counts_);
    BlockLeaves by_key;
    if (found.unsure != 0) find_leaves_by_key(tables_, x, particles_.id + begin, part, found.unsure, by_key);
    for (std::size_t j = 0; found.unsure != 0; found.unsure &= found.unsure - 1, ++j) {
      const auto k = at(std::countr_zero(found.unsure));
      found.boundary |= (settle(begin + k, found.leaf(k), by_key[j]) ? 0ULL : 1ULL) << k;
    }
    if (found.boundary != 0) boundary_.append(x, begin, part, count, found.boundary);
  }

  // True if a particle is interior; then its leaf's box grows to hold it. leaf: the one that its rounded coordinates
  // gave it; found: the one of its key, or -1.
  bool settle(std::size_t i, std::size_t leaf, std::int32_t found) {
    if (found < 0) return false;
    if (at(found) != leaf) {
      --counts_[leaf];
      leaf = at(found);
      ++counts_[leaf];
      part_[i] = tables_.part[leaf];
    }
    geometry::Box& box = tables_.box[leaf];
    for (std::size_t a = 0; a < axes(); ++a) {
      const double x = particles_.position[a][i];
      if (x >= box.lo[a] && x <= box.hi[a]) continue;
      box.lo[a] = std::min(box.lo[a], x);
      box.hi[a] = std::max(box.hi[a], x);
      tables_.set_bounds(leaf, a);
    }
    return true;
  }

  const particles::ParticleView& particles_;
  std::span<std::int32_t> part_;
  std::size_t boundary_max_;
  GuessTables tables_;
  OwnInterior& out_;
  BoundaryList boundary_;
  std::array<std::uint64_t, GuessTables::kLeaves> counts_{};
};

}  // namespace

OwnInterior classify_guessed(const particles::ParticleView& particles, const Guess& guess,
                             std::span<const NodeRange> roots, std::span<std::int32_t> part, std::size_t boundary_max) {
  OwnInterior out;
  out.reserve(particles, particles.count / 8);
  out.boxes.resize(guess.inner.size());
  out.counts.resize(guess.inner.size());
  GuessedPass(particles, guess, roots, part, boundary_max, out).run();
  out.finish(particles, boundary_max);
  return out;
}

}  // namespace rcb::partition
