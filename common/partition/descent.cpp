#include "common/partition/descent.hpp"

#include <algorithm>

#include "common/base/check.hpp"

namespace rcb::partition {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr std::size_t kBlock = 4096;  // particles between two looks at the list's room

}  // namespace

void Descent::start(const Guess& guess) {
  guess_ = &guess;
  nodes_ = static_cast<int>(guess.nodes().size());
  steps_max_ = guess.depth_max();
  steps_.resize(static_cast<std::size_t>(nodes_) * 2);
  tallies_.assign(steps_.size(), Tally{});
  for (std::size_t place = 0; place < steps_.size(); ++place) {
    const auto self = static_cast<std::int32_t>(place);
    steps_[place] = {kInfinity, kInfinity, {self, self, self}, 0};
  }
  for (std::int32_t g = 0; g < nodes_; ++g) {
    const GuessNode& node = guess.nodes()[static_cast<std::size_t>(g)];
    if (!node.inner) continue;
    // A node that sends all left has no bracket: infinite, which no coordinate reaches.
    steps_[static_cast<std::size_t>(g)] = {node.lo, node.hi, {node.left, g + nodes_, node.right}, node.axes[0]};
  }
}

void Descent::run(std::span<std::int32_t> label, std::span<const std::int32_t> start, Buffer<std::uint32_t>& stopped) {
  switch (particles_.dims) {
    case 1:
      return pass_of<1>(label, start, stopped);
    case 2:
      return pass_of<2>(label, start, stopped);
    default:
      return pass_of<3>(label, start, stopped);
  }
}

template <int kAxes>
void Descent::pass_of(std::span<std::int32_t> label, std::span<const std::int32_t> start,
                      Buffer<std::uint32_t>& stopped) {
  if (start.empty())
    measure_ ? pass<kAxes, true, true>(label, start, stopped) : pass<kAxes, false, true>(label, start, stopped);
  else
    measure_ ? pass<kAxes, true, false>(label, start, stopped) : pass<kAxes, false, false>(label, start, stopped);
}

template <int kAxes, bool kMeasure, bool kFirst>
void Descent::pass(std::span<std::int32_t> label, std::span<const std::int32_t> start, Buffer<std::uint32_t>& stopped) {
  constexpr auto kCount = static_cast<std::size_t>(kAxes);
  std::array<const double*, kCount> x{};
  std::copy_n(particles_.position.begin(), kCount, x.begin());
  const Step* const steps = steps_.data();
  Tally* const tallies = tallies_.data();
  const int levels = steps_max_;
  const std::int32_t brackets = nodes_;
  std::size_t found = stopped.size();
  for (std::size_t first = 0; first < label.size(); first += kBlock) {
    const std::size_t last = std::min(first + kBlock, label.size());
    if (stopped.capacity() < found + kBlock) {
      stopped.resize(found);
      stopped.reserve(std::max(found + kBlock, stopped.capacity() * 2));
    }
    std::uint32_t* const list = stopped.data();
    for (std::size_t i = first; i < last; ++i) {
      std::int32_t place = 0;
      if constexpr (!kFirst) {
        if (label[i] < 0) continue;
        place = start[static_cast<std::size_t>(label[i])];
        if (place < 0) {
          label[i] = place;
          continue;
        }
      }
      std::array<double, kCount> point;
      for (std::size_t a = 0; a < kCount; ++a) point[a] = x[a][i];
      for (int level = 0; level < levels; ++level) {
        const Step& step = steps[place];
        const double value = point[static_cast<std::size_t>(step.axis)];
        place = step.next[static_cast<std::size_t>(value >= step.lo) + static_cast<std::size_t>(value > step.hi)];
      }
      label[i] = place;
      Tally& tally = tallies[place];
      ++tally.count;
      if constexpr (kMeasure)
        for (std::size_t a = 0; a < kCount; ++a) {
          tally.lo[a] = point[a] < tally.lo[a] ? point[a] : tally.lo[a];
          tally.hi[a] = point[a] > tally.hi[a] ? point[a] : tally.hi[a];
        }
      list[found] = static_cast<std::uint32_t>(i);
      found += static_cast<std::size_t>(place >= brackets);
    }
  }
  stopped.resize(found);
}

std::int32_t Descent::go_on(std::size_t particle, std::int32_t node) {
  const Point point = particles_.point(particle);
  std::int32_t place = node;
  for (;;) {
    for (int level = 0; level < steps_max_; ++level) {
      const Step& step = steps_[static_cast<std::size_t>(place)];
      const double value = point[static_cast<std::size_t>(step.axis)];
      place = step.next[static_cast<std::size_t>(value >= step.lo) + static_cast<std::size_t>(value > step.hi)];
    }
    if (place < nodes_) break;
    const GuessNode& stop = guess_->nodes()[static_cast<std::size_t>(place - nodes_)];
    const std::int32_t next = stop.whole ? decide(particle, stop) : -1;
    if (next < 0) break;
    place = next;
  }
  Tally& tally = tallies_[static_cast<std::size_t>(place)];
  ++tally.count;
  if (measure_)
    for (std::size_t a = 0; a < static_cast<std::size_t>(particles_.dims); ++a) {
      tally.lo[a] = std::min(tally.lo[a], point[a]);
      tally.hi[a] = std::max(tally.hi[a], point[a]);
    }
  return place;
}

std::int32_t Descent::decide(std::size_t particle, const GuessNode& node) const {
  const Key key = key_of(particles_.point(particle), particles_.id[particle], node.axes, particles_.dims);
  if (node.lo > -kInfinity && key < node.lo_key) return node.left;
  if (node.hi < kInfinity && node.hi_key < key) return node.right;
  return -1;
}

}  // namespace rcb::partition
