#include "common/partition/incremental/partition_from_guess.hpp"

#include <algorithm>
#include <optional>

#include "common/base/index.hpp"
#include "common/comm/gather.hpp"
#include "common/partition/balance/bounding_box.hpp"
#include "common/partition/incremental/classify_guessed.hpp"
#include "common/partition/incremental/guess.hpp"
#include "common/partition/incremental/search_roots.hpp"
#include "common/partition/search/build_tree.hpp"
#include "common/partition/search/outermost.hpp"
#include "common/partition/search/sample.hpp"

namespace rcb::partition {
namespace {

using geometry::Box;

class FirstPartition {
 public:
  FirstPartition(comm::Comm& comm, const particles::ParticleView& particles, const PartitionOptions& options,
                 const LargeSetSample& large, SortedSample& sample, std::uint64_t reductions)
      : comm_(comm),
        particles_(particles),
        options_(options),
        limits_(options.limits.guess),
        rule_(options, particles.dims),
        large_(large),
        sample_(sample) {
    result_.reductions = reductions;
    result_.tree = uncut_tree(options, particles.dims);
    roots_ = {result_.tree.root()};
  }

  // False, on all ranks, if the root's cut was not found by a guess. Collective.
  bool run() {
    result_.part.resize(particles_.count);
    for (std::size_t stage = 0; stage < kGuessLevels && !roots_.empty(); ++stage)
      if (!cut_by_guess(stage == 0)) break;
    if (!roots_.empty() && roots_[0].parts() == options_.parts) return false;
    if (!roots_.empty()) cut_the_rest();
    return true;
  }

  PartitionResult take() { return std::move(result_); }

 private:
  // Guesses cuts below the roots, and makes them exact; the roots become what is uncut then. False, on all ranks, if
  // nothing was cut: each root's particles still have parts of that root. Collective.
  bool cut_by_guess(bool first) {
    Guess guess = share_guess();
    if (first && guess.open && gather_outermost(comm_, particles_, guess.sides, large_.stride, sample_, result_))
      guess = share_guess();
    if (!guess.found) return false;

    // The most boundary particles among `count`: 1.5 times the share that the guess was allowed.
    const auto most_of = [this](std::uint64_t count) {
      return static_cast<std::uint64_t>(std::min(1.5 * limits_.boundary_max, 1.0) * static_cast<double>(count));
    };
    const std::uint64_t mean = large_.count / static_cast<std::uint64_t>(comm_.size());
    OwnInterior own = classify_guessed(particles_, guess, roots_, result_.part.span(),
                                       most_of(std::max<std::uint64_t>(particles_.count, mean)));
    // Positions, and the parts written, and read where there are some already; then the copies of boundary particles,
    // whose positions are read once more for their box.
    const std::size_t point = at(axes()) * sizeof(double);
    result_.traffic.reads += particles_.count + own.slot.size();
    result_.traffic.bytes +=
        particles_.count * (point + (roots_[0].parts() == options_.parts ? 1 : 2) * sizeof(std::int32_t)) +
        own.slot.size() * (3 * point + 2 * sizeof(std::uint64_t));
    auto interior =
        sum_interior(comm_, own, {0, options_.parts}, loads_of(own), most_of(large_.count), result_.searched);
    ++result_.reductions;
    if (!interior) return false;
    interior->brackets.assign(guess.brackets.begin(), guess.brackets.end());
    TreeBuilder builder(comm_, own.view(particles_), options_,
                        {.roots = roots_,
                         .part = own.part.span(),
                         .tree = &result_.tree,
                         .rule = first ? nullptr : &rule_,
                         .scale = scale_,
                         .interior = &*interior});
    PartitionResult found = builder.build().value();
    rule_ = builder.rule();
    for (std::size_t k = 0; k < own.part.size(); ++k) result_.part[own.slot[k]] = own.part[k];
    add(std::move(found));
    roots_ = builder.uncut();
    guess_ = guess;
    if (!roots_.empty()) measure_roots(own, *interior);
    return true;
  }

  // That of rank 0, which alone has a sample. Collective (one gather).
  Guess share_guess() {
    Guess guess;
    if (comm_.rank() == 0)
      guess = guess_cuts(sample_, options_, {result_.tree, roots_, boxes_, rule_, guess_ ? &*guess_ : nullptr});
    ++result_.reductions;
    return comm::values_of_first<Guess>(comm_, {&guess, 1})[0];
  }

  // Of the particles' parts under a guess. Collective.
  LoadSummary loads_of(const OwnInterior& own) {
    if (!large_.has_weights) {
      std::vector<std::uint64_t> counts = own.counts;
      comm_.all_sum(counts);
      ++result_.reductions;
      return summarise_counts(std::move(counts), options_.part_sizes);
    }
    LoadSummary loads = summarise_loads(comm_, particles_, result_.part.span(), options_.part_sizes, options_.parts);
    result_.reductions += loads.weighted ? 3 : 2;
    if (loads.weighted) scale_.emplace(loads.scale_exponent);
    return loads;
  }

  // The exact boxes of the roots' particles, on all ranks. Collective (one reduction).
  void measure_roots(const OwnInterior& own, const Interior& interior) {
    // All of space is each part's inner region: so this finds the boxes of the boundary particles' parts.
    const std::vector<Box> anywhere(at(options_.parts), Box::unbounded());
    const OwnInterior found = classify_interior(own.view(particles_), nullptr, own.part.span(), anywhere,
                                                {0, options_.parts}, own.part.size());
    boxes_.clear();
    for (const NodeRange& root : roots_) {
      Box& box = boxes_.emplace_back(interior.box(root.first, root.last));
      for (int p = root.first; p < root.last; ++p) box.extend(found.boxes[at(p)]);
    }
    extend_by_all(comm_, boxes_, axes());
    ++result_.reductions;
  }

  // Cuts the roots by a search among all their particles. Collective.
  void cut_the_rest() {
    PartitionResult found = search_roots(comm_, particles_, options_,
                                         {.roots = roots_,
                                          .part = result_.part.span(),
                                          .boxes = boxes_,
                                          .tree = &result_.tree,
                                          .rule = &rule_,
                                          .scale = scale_});
    result_.searched += found.searched;
    add(std::move(found));
  }

  void add(PartitionResult found) {
    if (!scale_) {
      result_.counts.resize(at(options_.parts));
      for (const NodeRange& root : roots_)
        std::copy(found.counts.begin() + root.first, found.counts.begin() + root.last,
                  result_.counts.begin() + root.first);
    }
    result_.tree = std::move(found.tree);
    result_.rounds += found.rounds;
    result_.reductions += found.reductions;
    result_.traffic += found.traffic;
  }

  int axes() const { return particles_.dims; }

  comm::Comm& comm_;
  const particles::ParticleView& particles_;
  const PartitionOptions& options_;
  const GuessLimits& limits_;
  SplitRule rule_;
  std::optional<ExactScale> scale_;
  const LargeSetSample& large_;
  SortedSample& sample_;
  std::vector<NodeRange> roots_;  // not cut yet
  std::vector<Box> boxes_;        // of their particles; empty: not known
  std::optional<Guess> guess_;    // that left them uncut
  PartitionResult result_;
};

}  // namespace

bool may_guess(const PartitionOptions& options) {
  return options.parts <= std::min(options.limits.guess.parts_max, static_cast<int>(kGuessParts)) &&
         (options.previous == nullptr || options.axis_hysteresis <= 1);
}

std::optional<PartitionResult> partition_from_guess(comm::Comm& comm, const particles::ParticleView& particles,
                                                    const PartitionOptions& options, const LargeSetSample& large,
                                                    SortedSample& sample, PartitionResult& in_vain) {
  FirstPartition first(comm, particles, options, large, sample, in_vain.reductions);
  const bool found = first.run();
  PartitionResult result = first.take();
  if (found) return result;
  in_vain.reductions = result.reductions;
  in_vain.traffic = result.traffic;
  return std::nullopt;
}

}  // namespace rcb::partition
