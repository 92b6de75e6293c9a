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
struct Chosen {
  const Descent::Mover* mover;
  const std::uint32_t* index;
  double operator()(std::size_t k, std::size_t axis) const { return mover[index[k]].at[axis]; }
};

// The order of keys without a branch: where many keys share their first words no branch could be foretold.
bool before(const Point& a, Id a_id, const Point& b, Id b_id) {
  const bool by_third = (a[2] < b[2]) | ((a[2] == b[2]) & (a_id < b_id));
  const bool by_second = (a[1] < b[1]) | ((a[1] == b[1]) & by_third);
  return (a[0] < b[0]) | ((a[0] == b[0]) & by_second);
}

}  // namespace

void Descent::start(const Guess& guess) {
  guess_ = &guess;
  nodes_ = static_cast<int>(guess.nodes().size());
  steps_max_ = guess.depth_max();
  steps_.resize(static_cast<std::size_t>(nodes_) * 2);
  tallies_.assign(steps_.size(), Tally{});
  spare_.assign(steps_.size(), Tally{});
  stops_.clear();
  wholes_.clear();
  for (const GuessNode& node : guess.nodes()) stops_.push_back({node.depth, node.whole});
  if (std::ranges::any_of(stops_, &Stop::whole)) wholes_.resize(stops_.size());
  for (std::size_t place = 0; place < steps_.size(); ++place) {
    const auto self = static_cast<std::int32_t>(place);
    steps_[place] = {kInfinity, kInfinity, {self, self, self}, 0};
  }
  for (std::int32_t g = 0; g < nodes_; ++g) {
    const GuessNode& node = guess.nodes()[static_cast<std::size_t>(g)];
    if (!node.inner) continue;
    if (node.whole) {
      WholeStep& step = wholes_[static_cast<std::size_t>(g)];
      step.lo = node.lo_key;
      step.hi = node.hi_key;
      if (node.lo == -kInfinity) step.lo.at[0] = -kInfinity;
      if (node.hi == kInfinity) step.hi.at[0] = kInfinity;
      for (std::size_t w = 0; w < geometry::kDimsMax; ++w) step.axes[w] = static_cast<std::size_t>(node.axes[w]);
      step.next = {node.left, g + nodes_, node.right};
    }
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

// The step from node 0, where all begin: the same bracket for all needs no table.
void Descent::first_step(std::size_t first, std::size_t count, std::int32_t* place) const {
  const Step step = steps_[0];
  const double* const x = particles_.position[static_cast<std::size_t>(step.axis)] + first;
  for (std::size_t k = 0; k < count; ++k) {
    const std::int32_t up = x[k] > step.hi ? step.next[2] : step.next[1];
    place[k] = x[k] >= step.lo ? up : step.next[0];
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
  std::vector<Mover> movers(kBlock);
  std::vector<Mover> active(start.empty() ? 0 : kBlock);
  std::array<std::int32_t, kBlock> place;
  const auto take = [&](const auto& point, std::size_t count, std::int32_t* own, int levels) {
    descend(point, count, own, levels);
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
      first_step(first, count, own);
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
    const auto stop = [&](std::size_t s, std::size_t k) {
      movers[s].index = static_cast<std::uint32_t>(first + k);
      for (std::size_t a = 0; a < kCount; ++a) movers[s].at[a] = particles_.position[a][first + k];
      movers[s].place = own[k];
    };
    const auto stop_here = [&](std::size_t found) {
      settle(std::span(movers).first(found));
      for (std::size_t s = 0; s < found; ++s) rest(movers[s], label, waiting);
    };
    if (going == count) {  // as most often
      Neighbours<kAxes> point;
      for (std::size_t a = 0; a < kCount; ++a) point.x[a] = particles_.position[a] + first;
      const std::size_t found = take(point, count, own, start.empty() ? steps_max_ - 1 : steps_max_);
      for (std::size_t s = 0; s < found; ++s) stop(s, stopped[s]);
      stop_here(found);
      continue;
    }
    for (std::size_t g = 0; g < going; ++g) {
      const std::size_t k = stopped[g];
      active[g].index = static_cast<std::uint32_t>(k);
      for (std::size_t a = 0; a < kCount; ++a) active[g].at[a] = particles_.position[a][first + k];
      place[g] = own[k];
    }
    const std::size_t found = take(Listed{active.data()}, going, place.data(), steps_max_);
    for (std::size_t g = 0; g < going; ++g) own[active[g].index] = place[g];
    for (std::size_t s = 0; s < found; ++s) stop(s, active[stopped[s]].index);
    stop_here(found);
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
    for (std::size_t k = 0; k < count; ++k) block[k].place = place[k];
    settle({block, count});
    for (std::size_t k = 0; k < count; ++k) rest(block[k], label, waiting);
  }
  merge_spare();
}

void Descent::rest(Mover& mover, std::span<std::int32_t> label, std::vector<Buffer<Mover>>& waiting) const {
  label[mover.index] = mover.place;
  if (mover.place >= nodes_)
    waiting[static_cast<std::size_t>(stops_[static_cast<std::size_t>(mover.place - nodes_)].depth)].push_back(mover);
}

void Descent::settle(std::span<Mover> movers) {
  if (wholes_.empty()) return;
  std::array<std::uint32_t, kBlock> going;
  std::array<std::int32_t, kBlock> place;
  const auto in_whole = [this](std::int32_t at) {
    return at >= nodes_ && stops_[static_cast<std::size_t>(at - nodes_)].whole;
  };
  std::size_t count = 0;
  for (std::size_t k = 0; k < movers.size(); ++k) {
    going[count] = static_cast<std::uint32_t>(k);
    count += static_cast<std::size_t>(in_whole(movers[k].place));
  }
  while (count > 0) {
    std::size_t moved = 0;
    for (std::size_t g = 0; g < count; ++g) {
      const Mover& mover = movers[going[g]];
      const WholeStep& step = wholes_[static_cast<std::size_t>(mover.place - nodes_)];
      const std::array<double, geometry::kDimsMax> at{mover.at[step.axes[0]], mover.at[step.axes[1]],
                                                      mover.at[step.axes[2]]};
      const Id id = particles_.id[mover.index];
      const std::int32_t next = step.next[static_cast<std::size_t>(!before(at, id, step.lo.at, step.lo.id)) +
                                          static_cast<std::size_t>(before(step.hi.at, step.hi.id, at, id))];
      const bool goes = next != mover.place;
      tallies_[static_cast<std::size_t>(mover.place)].count -= static_cast<std::uint64_t>(goes);
      place[moved] = next;
      going[moved] = going[g];
      moved += static_cast<std::size_t>(goes);
    }
    const Chosen point{movers.data(), going.data()};
    descend(point, moved, place.data(), steps_max_);
    add<geometry::kDimsMax, true>(point, moved, place.data());
    count = 0;
    for (std::size_t g = 0; g < moved; ++g) {
      movers[going[g]].place = place[g];
      going[count] = going[g];
      count += static_cast<std::size_t>(in_whole(place[g]));
    }
  }
}

}  // namespace rcb::partition
