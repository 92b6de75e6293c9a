#include "common/partition/incremental/classify_guessed.hpp"

#include <algorithm>
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
        boundary_(particles, part.data(), out) {}

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
    const LeafCounts counts = counts_of(sums_);
    for (std::size_t leaf = 0; leaf < tables_.leaves; ++leaf) {
      out_.boxes[at(tables_.part[leaf])] = tables_.box(leaf);
      out_.counts[at(tables_.part[leaf])] = counts[leaf];
    }
  }

 private:
  void run_block(const Axes& x, std::size_t begin, std::size_t count) {
    std::int32_t* const part = part_.data() + begin;
    FoundLeaves found = find_leaves(tables_, x, part, count);
    if (found.unsure != 0) {
      std::uint64_t beyond = find_leaves_by_key(tables_, x, particles_.id + begin, part, found);
      for (; beyond != 0; beyond &= beyond - 1) {
        const auto k = at(std::countr_zero(beyond));
        tables_.extend(found.leaf(k), {x[0][k], x[1][k], x[2][k]});
      }
    }
    add_leaves(found, count, sums_);
    if (found.boundary != 0) boundary_.append(begin, found.boundary);
  }

  const particles::ParticleView& particles_;
  std::span<std::int32_t> part_;
  std::size_t boundary_max_;
  GuessTables tables_;
  OwnInterior& out_;
  BoundaryList boundary_;
  LeafCounts sums_{};
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
