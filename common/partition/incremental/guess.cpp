#include "common/partition/incremental/guess.hpp"

#include <algorithm>
#include <numeric>

#include "common/base/index.hpp"
#include "common/comm/self_comm.hpp"
#include "common/partition/incremental/repartition.hpp"
#include "common/partition/incremental/sample.hpp"
#include "common/partition/search/build_tree.hpp"

namespace rcb::partition {
namespace {

using geometry::Box;

// Particles outside of the sampled ones' box, about a stride of them at each side, are gathered if a stride is at most
// kStrideMax; a rank sends about kStridesMax strides at most, since more mean that the sample is unusual.
constexpr std::uint64_t kStrideMax = 32768;
constexpr std::uint64_t kStridesMax = 16;

// The slots of the particles outside of this box on some axis, about `most` of them at most.
std::vector<std::size_t> slots_beyond(const particles::ParticleView& particles, const Box& box, std::uint64_t most) {
  constexpr std::size_t kBlock = 64;
  std::vector<std::size_t> slots;
  for (std::size_t a = 0; a < at(particles.dims); ++a) {
    const double* const x = particles.position[a];
    const double lo = box.lo[a];
    const double hi = box.hi[a];
    for (std::size_t begin = 0; begin < particles.count && slots.size() < most; begin += kBlock) {
      const std::size_t end = std::min(begin + kBlock, particles.count);
      bool any = false;
      for (std::size_t i = begin; i < end; ++i) any |= (x[i] < lo) | (x[i] > hi);
      for (std::size_t i = begin; any && i < end; ++i)
        if (x[i] < lo || x[i] > hi) slots.push_back(i);
    }
  }
  return slots;
}

class Guess {
 public:
  enum class Verdict { good, axes_open, bad };

  Guess(const Sample& sample, const PartitionOptions& options) : options_(options), set_(sample.particles) {
    for (std::size_t k = 0; k < sample.count(); ++k) sampled_.extend(sample.particles.view().point(k), dims());
  }

  const Box& sampled_box() const { return sampled_; }
  const CutTree& tree() const { return tree_; }

  // Adds all particles outside of the sampled ones' box. Their weight is 0: they matter for extents only.
  void add_outermost(const Sample& sample) {
    const std::size_t had = set_.count();
    for (std::size_t a = 0; a < at(dims()); ++a) set_.position[a].append(sample.particles.position[a].span());
    set_.id.resize(had + sample.count());
    set_.weight.resize(set_.count());
    std::iota(set_.id.begin(), set_.id.end(), particles::Id{0});
    std::fill(set_.weight.begin() + had, set_.weight.end(), 0.0);
    outermost_ = true;
  }

  // Makes the tree of the particles so far, and judges it. Local.
  Verdict make() {
    comm::SelfComm self;
    PartitionResult found = TreeBuilder(self, set_.view(), options_, dims()).build();
    tree_ = std::move(found.tree);
    part_ = std::move(found.part);
    boxes_.assign(at(options_.parts), Box{});
    for (std::size_t k = 0; k < set_.count(); ++k) boxes_[at(part_[k])].extend(set_.view().point(k), dims());
    all_ = box_of(tree_.root());
    return judge(tree_.root());
  }

 private:
  int dims() const { return set_.dims; }

  Box box_of(const NodeRange& range) const {
    Box all;
    for (int p = range.first; p < range.last; ++p) all.extend(boxes_[at(p)]);
    return all;
  }

  Verdict judge(const NodeRange& range) const {
    if (range.leaf()) return Verdict::good;
    const Cut& cut = tree_.cuts[at(range.node)];
    const Box box = box_of(range);
    if (cut.right_empty || box.empty(dims()) || tied(range, cut)) return Verdict::bad;
    const Verdict own = axis_is_known(box, cut.axes[0]) ? Verdict::good : Verdict::axes_open;
    return std::max({own, judge(range.left()), judge(range.right())});
  }

  bool tied(const NodeRange& range, const Cut& cut) const {
    std::size_t all = 0;
    std::size_t on = 0;
    for (std::size_t k = 0; k < set_.count(); ++k) {
      if (part_[k] < range.first || part_[k] >= range.last) continue;
      ++all;
      on += set_.position[at(cut.axes[0])][k] == cut.key.at[0] ? 1U : 0U;
    }
    return static_cast<double>(on) > 1 + options_.limits.guess.tied * static_cast<double>(all);
  }

  // True if this axis is the longest even if the node's particles reach beyond those in the set as far as GuessLimits
  // says.
  bool axis_is_known(const Box& box, int axis) const {
    if (options_.method != Method::rcb) return true;
    const auto length = [&](std::size_t a) { return geometry::extent(box.lo[a], box.hi[a]); };
    for (std::size_t a = 0; a < at(dims()); ++a) {
      if (a == at(axis)) continue;
      // All particles outside of the sampled ones' box are in the set: a node's side that ends there is exact.
      const bool known_lo = outermost_ && (box.lo[a] < sampled_.lo[a] || box.lo[a] == all_.lo[a]);
      const bool known_hi = outermost_ && (box.hi[a] > sampled_.hi[a] || box.hi[a] == all_.hi[a]);
      const double most =
          length(a) * (1 + options_.limits.guess.overhang_max * (2 - (known_lo ? 1 : 0) - (known_hi ? 1 : 0)));
      if (most > length(at(axis))) return false;
    }
    return true;
  }

  const PartitionOptions& options_;
  particles::ParticleSet set_;
  Box sampled_;
  Box all_;  // of the set
  bool outermost_ = false;
  CutTree tree_;
  Buffer<std::int32_t> part_;  // of the set
  std::vector<Box> boxes_;     // of the parts
};

}  // namespace

std::optional<PartitionResult> partition_from_guess(comm::Comm& comm, const particles::ParticleView& particles,
                                                    const PartitionOptions& options, std::uint64_t& reductions) {
  reductions = 0;
  const GuessLimits& limits = options.limits.guess;
  if (options.parts < limits.parts_min || options.parts > limits.parts_max) return std::nullopt;
  // With hysteresis the previous tree influences the axes, and within a tolerance cuts depend on where a search begins.
  if (options.cut_tolerance > 0 || (options.previous != nullptr && options.axis_hysteresis > 1)) return std::nullopt;
  std::vector<std::uint64_t> count{particles.count};
  comm.all_sum(count);
  ++reductions;
  if (count[0] / static_cast<std::uint64_t>(comm.size()) < limits.count_min) return std::nullopt;

  const std::uint64_t wanted = std::clamp(count[0] / limits.stride, limits.sample_min, limits.sample_max);
  const std::uint64_t stride = std::max<std::uint64_t>(count[0] / wanted, 1);
  Guess guess(share_sample(comm, particles, nullptr, pick(particles.count, stride)), options);
  Guess::Verdict verdict = guess.make();
  ++reductions;
  if (verdict == Guess::Verdict::axes_open && stride <= kStrideMax) {
    const auto slots = slots_beyond(particles, guess.sampled_box(), kStridesMax * (stride + 64));
    guess.add_outermost(share_sample(comm, particles, nullptr, slots));
    ++reductions;
    verdict = guess.make();
  }
  if (verdict != Guess::Verdict::good) return std::nullopt;

  PartitionResult result;
  result.part.resize(particles.count);
  guess.tree().classify(particles, result.part.span());
  const LoadSummary loads = summarise_loads(comm, particles, result.part.span(), options.part_sizes, options.parts);
  reductions += loads.weighted ? 3 : 1;
  RepartitionOptions again;
  again.partition = options;
  Repartition exact =
      repartition(comm, particles, again, {guess.tree(), result.part.span(), loads, {0, options.parts}});
  for (std::size_t k = 0; k < exact.delta.slot.size(); ++k) result.part[exact.delta.slot[k]] = exact.delta.part[k];
  result.tree = std::move(exact.tree);
  if (!exact.loads.weighted) result.counts = std::move(exact.loads.counts);
  result.searched = exact.looked_at;
  result.rounds = exact.rounds;
  reductions += exact.reductions;
  result.reductions = reductions;
  return result;
}

}  // namespace rcb::partition
