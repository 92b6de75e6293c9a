#include "common/partition/descent.hpp"

#include <algorithm>

#include "common/base/check.hpp"

namespace rcb::partition {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr std::size_t kBlock = 256;  // particles that take their steps together: their places stay in the cache

// The coordinates of a block: of neighbours in the set, or of movers.
template <int kAxes>
struct Neighbours {
  std::array<const double*, static_cast<std::size_t>(kAxes)> x;
  double operator()(std::size_t k, std::size_t axis) const { return x[axis][k]; }
};
struct Listed {
  const Descent::Mover* mover;
  double operator()(std::size_t k, std::size_t axis) const { return mover[k].at[axis]; }
};

}  // namespace

void Descent::start(const Guess& guess) {
  guess_ = &guess;
  nodes_ = static_cast<int>(guess.nodes().size());
  steps_max_ = guess.depth_max();
  steps_.resize(static_cast<std::size_t>(nodes_) * 2);
  tallies_.assign(steps_.size(), Tally{});
  spare_.assign(steps_.size(), Tally{});
  stops_.clear();
  for (const GuessNode& node : guess.nodes()) stops_.push_back({node.depth, node.whole});
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

void Descent::run(std::span<std::int32_t> label, std::span<const std::int32_t> start,
                  std::vector<Buffer<Mover>>& waiting) {
  switch (particles_.dims) {
    case 1:
      pass<1>(label, start, waiting);
      break;
    case 2:
      pass<2>(label, start, waiting);
      break;
    default:
      pass<3>(label, start, waiting);
      break;
  }
  merge_spare();
}

// One step for all of a block, then the next: the steps of different particles don't wait for each other.
template <typename Point>
void Descent::descend(const Point& point, std::size_t count, std::int32_t* place, int levels) const {
  const Step* const steps = steps_.data();
  for (int level = 0; level < levels; ++level)
    for (std::size_t k = 0; k < count; ++k) {
      const Step& step = steps[place[k]];
      const double value = point(k, static_cast<std::size_t>(step.axis));
      place[k] = step.next[static_cast<std::size_t>(value >= step.lo) + static_cast<std::size_t>(value > step.hi)];
    }
}

template <int kAxes, bool kMeasure, typename Point>
void Descent::add(const Point& point, std::size_t count, const std::int32_t* place) {
  const std::array<Tally*, 2> tallies{tallies_.data(), spare_.data()};
  for (std::size_t k = 0; k < count; ++k) {
    Tally& tally = tallies[k % 2][place[k]];
    ++tally.count;
    if constexpr (kMeasure)
      for (std::size_t a = 0; a < static_cast<std::size_t>(kAxes); ++a) {
        const double value = point(k, a);
        tally.lo[a] = value < tally.lo[a] ? value : tally.lo[a];
        tally.hi[a] = value > tally.hi[a] ? value : tally.hi[a];
      }
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
void Descent::pass(std::span<std::int32_t> label, std::span<const std::int32_t> start,
                   std::vector<Buffer<Mover>>& waiting) {
  constexpr auto kCount = static_cast<std::size_t>(kAxes);
  const bool measure = guess_->measured_depth() > 0;
  std::array<std::uint32_t, kBlock> stopped;
  std::vector<Mover> active(start.empty() ? 0 : kBlock);
  std::array<std::int32_t, kBlock> place;
  const auto take = [&](const auto& point, std::size_t count, std::int32_t* own) {
    descend(point, count, own, steps_max_);
    measure ? add<kAxes, true>(point, count, own) : add<kAxes, false>(point, count, own);
    std::size_t found = 0;
    for (std::size_t k = 0; k < count; ++k) {
      stopped[found] = static_cast<std::uint32_t>(k);
      found += static_cast<std::size_t>(own[k] >= nodes_);
    }
    return found;
  };
  for (std::size_t first = 0; first < label.size(); first += kBlock) {
    const std::size_t count = std::min(kBlock, label.size() - first);
    std::int32_t* const own = label.data() + first;
    std::size_t going = count;
    if (start.empty()) {
      std::fill_n(own, count, 0);
    } else {
      going = 0;
      for (std::size_t k = 0; k < count; ++k) {
        const std::int32_t from = start[static_cast<std::size_t>(std::max(own[k], 0))];  // no branch
        own[k] = own[k] < 0 ? own[k] : from;
        stopped[going] = static_cast<std::uint32_t>(k);
        going += static_cast<std::size_t>(own[k] >= 0);
      }
    }
    if (going == 0) continue;
    Mover mover{};
    const auto stop = [&](std::size_t k) {
      mover.index = static_cast<std::uint32_t>(first + k);
      for (std::size_t a = 0; a < kCount; ++a) mover.at[a] = particles_.position[a][first + k];
      mover.place = own[k];
      if (stops_[static_cast<std::size_t>(mover.place - nodes_)].whole) settle(mover);
      rest(mover, label, waiting);
    };
    if (going == count) {  // as most often
      Neighbours<kAxes> point;
      for (std::size_t a = 0; a < kCount; ++a) point.x[a] = particles_.position[a] + first;
      const std::size_t found = take(point, count, own);
      for (std::size_t s = 0; s < found; ++s) stop(stopped[s]);
      continue;
    }
    for (std::size_t g = 0; g < going; ++g) {
      const std::size_t k = stopped[g];
      active[g].index = static_cast<std::uint32_t>(k);
      for (std::size_t a = 0; a < kCount; ++a) active[g].at[a] = particles_.position[a][first + k];
      place[g] = own[k];
    }
    const std::size_t found = take(Listed{active.data()}, going, place.data());
    for (std::size_t g = 0; g < going; ++g) own[active[g].index] = place[g];
    for (std::size_t s = 0; s < found; ++s) stop(active[stopped[s]].index);
  }
}

void Descent::go_on(std::span<Mover> movers, int depth, std::span<std::int32_t> label,
                    std::vector<Buffer<Mover>>& waiting) {
  const bool measure = guess_->measured_depth() >= depth;
  std::array<std::int32_t, kBlock> place;
  for (std::size_t first = 0; first < movers.size(); first += kBlock) {
    const std::size_t count = std::min(kBlock, movers.size() - first);
    Mover* const block = movers.data() + first;
    for (std::size_t k = 0; k < count; ++k) place[k] = block[k].place;
    descend(Listed{block}, count, place.data(), steps_max_ - depth);
    // Axes that the set lacks are 0 in every mover: measured for nothing.
    measure ? add<geometry::kDimsMax, true>(Listed{block}, count, place.data())
            : add<geometry::kDimsMax, false>(Listed{block}, count, place.data());
    for (std::size_t k = 0; k < count; ++k) {
      block[k].place = place[k];
      if (place[k] >= nodes_ && stops_[static_cast<std::size_t>(place[k] - nodes_)].whole) settle(block[k]);
      rest(block[k], label, waiting);
    }
  }
  merge_spare();
}

void Descent::rest(Mover& mover, std::span<std::int32_t> label, std::vector<Buffer<Mover>>& waiting) const {
  label[mover.index] = mover.place;
  if (mover.place >= nodes_)
    waiting[static_cast<std::size_t>(stops_[static_cast<std::size_t>(mover.place - nodes_)].depth)].push_back(mover);
}

void Descent::settle(Mover& mover) {
  while (mover.place >= nodes_) {
    const GuessNode& node = guess_->nodes()[static_cast<std::size_t>(mover.place - nodes_)];
    const std::int32_t next = node.whole ? decide(mover, node) : -1;
    if (next < 0) return;
    --tallies_[static_cast<std::size_t>(mover.place)].count;
    mover.place = next;
    descend(Listed{&mover}, 1, &mover.place, steps_max_ - node.depth - 1);
    add<geometry::kDimsMax, true>(Listed{&mover}, 1, &mover.place);
  }
}

std::int32_t Descent::decide(const Mover& mover, const GuessNode& node) const {
  const Key key = key_of(mover.at, particles_.id[mover.index], node.axes, particles_.dims);
  if (node.lo > -kInfinity && key < node.lo_key) return node.left;
  if (node.hi < kInfinity && node.hi_key < key) return node.right;
  return -1;
}

}  // namespace rcb::partition
