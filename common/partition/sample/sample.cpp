#include "common/partition/sample/sample.hpp"

#include <algorithm>
#include <cmath>

#include "common/base/index.hpp"
#include "common/base/random.hpp"
#include "common/comm/gather.hpp"

namespace rcb::partition {

std::vector<std::size_t> sampled_slots(std::size_t count, std::uint64_t stride) {
  std::vector<std::size_t> slots;
  for (std::size_t begin = 0; begin < count; begin += stride)
    slots.push_back(begin + mix64(begin) % std::min<std::uint64_t>(stride, count - begin));
  return slots;
}

Buffer<SampledParticle> gather_sample(comm::Comm& comm, const particles::ParticleView& particles,
                                      std::span<const std::size_t> slots, std::span<const std::int32_t> part) {
  // Taking a message from each of more ranks, one by one, takes longer than an all-gather.
  constexpr int kOneByOneMax = 1024;
  std::vector<SampledParticle> mine;
  for (const std::size_t slot : slots) mine.push_back({particles.point(slot), part.empty() ? 0 : part[slot]});
  const std::span<const SampledParticle> rows = mine;
  if (comm.size() <= kOneByOneMax) return comm::gather_values(comm, rows);
  Buffer<SampledParticle> all = comm::all_gather_values(comm, rows).values;
  if (comm.rank() != 0) all.resize(0);
  return all;
}

geometry::Box box_of(Sample sample, int dims) {
  geometry::Box box;
  for (const SampledParticle& own : sample) box.extend(own.x, dims);
  return box;
}

// Only what is needed is put in order: the two ends of the bracket, and the cut between them. Ties are broken as for
// keys: otherwise a cut through many particles with one coordinate would leave the wrong ones on its left.
DividedSample divide_sample(Sample own, const SampledCut& cut, const Tuning& tuning) {
  constexpr double kInfinity = geometry::Box::kInfinity;
  const auto axis = at(cut.axes[0]);
  const auto less = [axis, second = at(cut.axes[1]), third = at(cut.axes[2])](const auto& a, const auto& b) {
    if (a.x[axis] != b.x[axis]) return a.x[axis] < b.x[axis];
    if (a.x[second] != b.x[second]) return a.x[second] < b.x[second];
    return a.x[third] < b.x[third];
  };
  const auto in_place = [&](double k, auto first, auto last) {
    const auto kth = own.begin() + static_cast<std::ptrdiff_t>(std::clamp(k, 0.0, static_cast<double>(own.size())));
    std::nth_element(first, kth, last, less);
    return kth;
  };
  const auto coordinate = [&](double k, auto kth) {
    return k < 0 ? -kInfinity : kth == own.end() ? kInfinity : kth->x[axis];
  };
  const double half_width = tuning.bracket_sigmas * cut.deviation + tuning.bracket_margin;
  const double first = std::floor(cut.below - half_width);
  const double last = std::ceil(cut.below + half_width);
  Bracket bracket;
  const auto least = in_place(first, own.begin(), own.end());
  if (!own.empty()) bracket.least = coordinate(first, least);
  const auto most = in_place(last, least, own.end());
  if (!own.empty()) bracket.most = coordinate(last, most);
  const auto middle = in_place(cut.below, least, most);
  return {{own.begin(), middle}, {middle, own.end()}, bracket};
}

}  // namespace rcb::partition
