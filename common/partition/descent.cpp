#include "common/partition/descent.hpp"

#include <algorithm>

#include "common/base/check.hpp"

namespace rcb::partition {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr std::size_t kBlock = 256;  // particles that take their steps together: their places stay in the cache

// Which particles a block holds: neighbours, or listed ones.
struct Neighbours {
  std::size_t first;
  std::size_t operator[](std::size_t k) const { return first + k; }
};

// Appends to a list without a branch; room for a whole block is made before.
void make_room(Buffer<std::uint32_t>& list, std::size_t used) {
  if (list.capacity() >= used + kBlock) return;
  list.resize(used);
  list.reserve(std::max(used + kBlock, list.capacity() * 2));
}

}  // namespace

void Descent::start(const Guess& guess) {
  guess_ = &guess;
  nodes_ = static_cast<int>(guess.nodes().size());
  steps_max_ = guess.depth_max();
  steps_.resize(static_cast<std::size_t>(nodes_) * 2);
  tallies_.assign(steps_.size(), Tally{});
  spare_.assign(steps_.size(), Tally{});
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
  const bool first = start.empty();
  measure_ = guess_->measured_depth() > 0;
  switch (particles_.dims) {
    case 1:
      first ? pass_first<1>(label, stopped) : pass_next<1>(label, start, stopped);
      break;
    case 2:
      first ? pass_first<2>(label, stopped) : pass_next<2>(label, start, stopped);
      break;
    default:
      first ? pass_first<3>(label, stopped) : pass_next<3>(label, start, stopped);
      break;
  }
  merge_spare();
}

// One step for all of a block, then the next: the steps of different particles don't wait for each other.
template <typename Index>
void Descent::descend(const Index& index, std::size_t count, std::int32_t* place, int levels) const {
  const std::array<const double*, geometry::kDimsMax> x = particles_.position;
  const Step* const steps = steps_.data();
  for (int level = 0; level < levels; ++level)
    for (std::size_t k = 0; k < count; ++k) {
      const Step& step = steps[place[k]];
      const double value = x[static_cast<std::size_t>(step.axis)][index[k]];
      place[k] = step.next[static_cast<std::size_t>(value >= step.lo) + static_cast<std::size_t>(value > step.hi)];
    }
}

template <int kAxes, bool kMeasure, typename Index>
void Descent::add_measured(const Index& index, std::size_t count, const std::int32_t* place) {
  constexpr auto kCount = static_cast<std::size_t>(kAxes);
  std::array<const double*, kCount> x{};
  std::copy_n(particles_.position.begin(), kCount, x.begin());
  const std::array<Tally*, 2> tallies{tallies_.data(), spare_.data()};
  for (std::size_t k = 0; k < count; ++k) {
    Tally& tally = tallies[k % 2][place[k]];
    ++tally.count;
    if constexpr (kMeasure)
      for (std::size_t a = 0; a < kCount; ++a) {
        const double value = x[a][index[k]];
        tally.lo[a] = value < tally.lo[a] ? value : tally.lo[a];
        tally.hi[a] = value > tally.hi[a] ? value : tally.hi[a];
      }
  }
}

template <int kAxes, typename Index>
void Descent::add(const Index& index, std::size_t count, const std::int32_t* place) {
  measure_ ? add_measured<kAxes, true>(index, count, place) : add_measured<kAxes, false>(index, count, place);
}

void Descent::add_any(std::span<const std::uint32_t> index, const std::int32_t* place) {
  switch (particles_.dims) {
    case 1:
      return add<1>(index, index.size(), place);
    case 2:
      return add<2>(index, index.size(), place);
    default:
      return add<3>(index, index.size(), place);
  }
}

void Descent::merge_spare() {
  for (std::size_t place = 0; place < tallies_.size(); ++place) {
    Tally& tally = tallies_[place];
    Tally& other = spare_[place];
    tally.count += other.count;
    for (std::size_t a = 0; a < geometry::kDimsMax; ++a) {
      tally.lo[a] = std::min(tally.lo[a], other.lo[a]);
      tally.hi[a] = std::max(tally.hi[a], other.hi[a]);
    }
    other = Tally{};
  }
}

template <int kAxes>
void Descent::pass_first(std::span<std::int32_t> label, Buffer<std::uint32_t>& stopped) {
  std::size_t found = stopped.size();
  for (std::size_t first = 0; first < label.size(); first += kBlock) {
    const std::size_t count = std::min(kBlock, label.size() - first);
    std::int32_t* const place = label.data() + first;
    std::fill_n(place, count, 0);
    descend(Neighbours{first}, count, place, steps_max_);
    add<kAxes>(Neighbours{first}, count, place);
    make_room(stopped, found);
    std::uint32_t* const list = stopped.data();
    for (std::size_t k = 0; k < count; ++k) {
      list[found] = static_cast<std::uint32_t>(first + k);
      found += static_cast<std::size_t>(place[k] >= nodes_);
    }
  }
  stopped.resize(found);
}

template <int kAxes>
void Descent::pass_next(std::span<std::int32_t> label, std::span<const std::int32_t> start,
                        Buffer<std::uint32_t>& stopped) {
  std::array<std::uint32_t, kBlock> index;
  std::array<std::int32_t, kBlock> place;
  std::size_t found = stopped.size();
  for (std::size_t first = 0; first < label.size(); first += kBlock) {
    const std::size_t last = std::min(first + kBlock, label.size());
    std::size_t count = 0;
    for (std::size_t i = first; i < last; ++i) {
      const std::int32_t old = label[i];
      const std::int32_t found_start = start[static_cast<std::size_t>(std::max(old, 0))];  // no branch
      const std::int32_t from = old < 0 ? old : found_start;
      label[i] = from;
      index[count] = static_cast<std::uint32_t>(i);
      place[count] = from;
      count += static_cast<std::size_t>(from >= 0);
    }
    make_room(stopped, found);
    std::uint32_t* const list = stopped.data();
    if (count == last - first) {  // as most often: the labels are the places
      std::int32_t* const own = label.data() + first;
      descend(Neighbours{first}, count, own, steps_max_);
      add<kAxes>(Neighbours{first}, count, own);
      for (std::size_t k = 0; k < count; ++k) {
        list[found] = static_cast<std::uint32_t>(first + k);
        found += static_cast<std::size_t>(own[k] >= nodes_);
      }
      continue;
    }
    descend(index, count, place.data(), steps_max_);
    add<kAxes>(index, count, place.data());
    for (std::size_t k = 0; k < count; ++k) {
      label[index[k]] = place[k];
      list[found] = index[k];
      found += static_cast<std::size_t>(place[k] >= nodes_);
    }
  }
  stopped.resize(found);
}

void Descent::go_on(std::span<const std::uint32_t> index, std::span<std::int32_t> place, int levels, bool measure) {
  measure_ = measure;
  for (std::size_t first = 0; first < index.size(); first += kBlock) {
    const std::size_t count = std::min(kBlock, index.size() - first);
    const std::span<const std::uint32_t> block = index.subspan(first, count);
    std::int32_t* const own = place.data() + first;
    descend(block, count, own, levels);
    for (std::size_t k = 0; k < count; ++k)
      while (own[k] >= nodes_) {
        const GuessNode& stop = guess_->nodes()[static_cast<std::size_t>(own[k] - nodes_)];
        const std::int32_t next = stop.whole ? decide(block[k], stop) : -1;
        if (next < 0) break;
        own[k] = next;
        descend(block.subspan(k, 1), 1, own + k, levels);
      }
    add_any(block, own);
  }
  merge_spare();
}

std::int32_t Descent::decide(std::size_t particle, const GuessNode& node) const {
  const Key key = key_of(particles_.point(particle), particles_.id[particle], node.axes, particles_.dims);
  if (node.lo > -kInfinity && key < node.lo_key) return node.left;
  if (node.hi < kInfinity && node.hi_key < key) return node.right;
  return -1;
}

}  // namespace rcb::partition
