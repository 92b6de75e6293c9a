// Room `sample`: what a few of the particles tell before any pass over all of them: where the cuts are expected, and
// how coordinates become integers. A guess: a wrong one costs time only.
//
// A sample: some of every rank's particles, on rank 0. It is cut as all particles are to be cut.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/comm/comm.hpp"
#include "common/particles/particle_set.hpp"
#include "common/partition/rules/request.hpp"

namespace rcb::partition {

struct SampledParticle {
  Point x{};
  std::int64_t part = 0;  // where cuts are in force
};

using Sample = std::span<SampledParticle>;

// One slot of every `stride` of [0, count), chosen by a hash, since solvers' arrays may be periodic. Local.
std::vector<std::size_t> sampled_slots(std::size_t count, std::uint64_t stride);

// The particles in these slots of every rank in rank order, on rank 0; nothing elsewhere.
//   part  [particles.count], or none
// Collective (one gather).
Buffer<SampledParticle> gather_sample(comm::Comm& comm, const particles::ParticleView& particles,
                                      std::span<const std::size_t> slots, std::span<const std::int32_t> part = {});

// Empty without particles.
geometry::Box box_of(Sample sample, int dims);

// A node's cut, as its sampled particles show it: how many of them are expected below it, and the standard deviation of
// this number.
struct SampledCut {
  AxisOrder axes{0, 1, 2};
  double below = 0;
  double deviation = 0;
};

// A cut is expected among the coordinates from `least` to `most`.
struct Bracket {
  double least = -geometry::Box::kInfinity;
  double most = geometry::Box::kInfinity;
};

// Puts those that are expected below the cut in front; says how many these are, and where the cut is expected:
// unbounded where it may lie beyond all sampled particles. Local.
struct DividedSample {
  Sample left;
  Sample right;
  Bracket bracket;
};
DividedSample divide_sample(Sample own, const SampledCut& cut, const Tuning& tuning);

// Cuts a sample as all particles are to be cut, from this node on. Local.
//   heap    the node's number among the splitters
//   expect  for each inner node tells the cut of its sampled particles, or nullopt: then nothing below it is cut
//   note    is told where each of these cuts is expected: anywhere, if it isn't known
template <typename Expect, typename Note>
void cut_sample(Sample own, const NodeRange& range, std::size_t heap, const Tuning& tuning, const Expect& expect,
                const Note& note) {
  if (range.leaf()) return;
  const std::optional<SampledCut> cut = expect(range, heap, own);
  const DividedSample divided = cut ? divide_sample(own, *cut, tuning) : DividedSample{};
  note(range, heap, cut.value_or(SampledCut{}).axes[0], divided.bracket);
  if (!cut) return;
  cut_sample(divided.left, range.left(), 2 * heap + 1, tuning, expect, note);
  cut_sample(divided.right, range.right(), 2 * heap + 2, tuning, expect, note);
}

}  // namespace rcb::partition
