// Brackets: where cuts are expected, read off a sample.
#pragma once

#include <algorithm>
#include <cmath>
#include <optional>

#include "common/base/index.hpp"
#include "common/partition/rules/request.hpp"
#include "common/partition/sample/sorted_sample.hpp"

namespace rcb::partition {

// A cut is expected among the coordinates from `least` to `most`.
struct Bracket {
  double least = -geometry::Box::kInfinity;
  double most = geometry::Box::kInfinity;

  bool anywhere() const { return least == -geometry::Box::kInfinity && most == geometry::Box::kInfinity; }
};

// A node's cut, as its sampled particles show it: how many of them are expected below it, and the standard deviation of
// this number.
struct SampledCut {
  int axis = 0;
  double below = 0;
  double deviation = 0;

  // The cut that leaves this share of all particles on its left.
  static SampledCut at_share(int axis, double share, std::size_t count) {
    const auto n = static_cast<double>(count);
    return {axis, share * n, std::sqrt(share * (1 - share) * n)};
  }
};

// By `count` coordinates, of which coordinate_at(k) is the k-th least. It is unbounded where it reaches beyond all.
template <typename CoordinateAt>
Bracket bracket_of(const SampledCut& cut, std::size_t count, const Tuning& tuning, const CoordinateAt& coordinate_at) {
  if (count == 0) return {};
  const double half_width = tuning.bracket_sigmas * cut.deviation + tuning.bracket_margin;
  const auto end_at = [&](double k) {
    if (k < 0) return -geometry::Box::kInfinity;
    return k < static_cast<double>(count) ? coordinate_at(static_cast<std::size_t>(k)) : geometry::Box::kInfinity;
  };
  return {end_at(std::floor(cut.below - half_width)), end_at(std::ceil(cut.below + half_width))};
}

inline Bracket bracket_of(const SortedSample& sample, const SortedSample::Range& own, const SampledCut& cut,
                          const Tuning& tuning) {
  return bracket_of(cut, own.size(), tuning, [&](std::size_t k) { return sample.x(own, at(cut.axis), k); });
}

// Cuts a sample as all particles are to be cut, from this node on. For each inner node expect(range, heap, own) tells
// its cut, or nullopt: then nothing below it is cut. Afterwards the sample as a whole isn't in order any more.
//   heap  the node's number among the splitters
//   own   its sampled particles
template <typename Expect>
void cut_sample(SortedSample& sample, const NodeRange& range, std::size_t heap, const SortedSample::Range& own,
                const Expect& expect) {
  if (range.leaf()) return;
  const std::optional<SampledCut> cut = expect(range, heap, own);
  if (!cut) return;
  const double left = std::clamp(cut->below, 0.0, static_cast<double>(own.size()));
  const SortedSample::Halves halves = sample.split(own, at(cut->axis), static_cast<std::size_t>(left));
  cut_sample(sample, range.left(), 2 * heap + 1, halves.left, expect);
  cut_sample(sample, range.right(), 2 * heap + 2, halves.right, expect);
}

}  // namespace rcb::partition
