// What a build begins with: bounds and counts of all particles, how coordinates become integers, the records of the
// nodes to begin at.
#include <algorithm>
#include <utility>

#include "common/base/random.hpp"
#include "common/partition/build_tree.hpp"
#include "common/partition/wide_sum.hpp"

namespace rcb::partition {
namespace {

constexpr std::uint64_t kNoImage = ~std::uint64_t{0};
constexpr std::size_t kSampleMax = 256;  // particles of a rank that are looked at to choose a map
constexpr std::size_t kSampleBins = 512;
constexpr std::size_t kSampleWords = 2 * kSampleBins + 1;

std::size_t at(int index) { return static_cast<std::size_t>(index); }

// Least and greatest of an array. Four of each at once, since one would wait for itself.
void least_and_most(std::span<const double> values, double& lo, double& hi) {
  std::array<double, 4> least;
  std::array<double, 4> most;
  least.fill(lo);
  most.fill(hi);
  std::size_t i = 0;
  for (; i + 4 <= values.size(); i += 4)
    for (std::size_t k = 0; k < 4; ++k) {
      const double value = values[i + k];
      least[k] = value < least[k] ? value : least[k];
      most[k] = value > most[k] ? value : most[k];
    }
  for (; i < values.size(); ++i) {
    least[0] = std::min(least[0], values[i]);
    most[0] = std::max(most[0], values[i]);
  }
  lo = *std::ranges::min_element(least);
  hi = *std::ranges::max_element(most);
}

}  // namespace

void TreeBuilder::measure_all() {
  std::vector<std::uint64_t> least(2 * geometry::kDimsMax + 2, kNoImage);
  for (int a = 0; a < axes_ && particles_.count > 0; ++a) {
    double lo = particles_.position[at(a)][0];
    double hi = lo;
    least_and_most({particles_.position[at(a)], particles_.count}, lo, hi);
    least[at(a)] = geometry::image(lo);
    least[geometry::kDimsMax + at(a)] = ~geometry::image(hi);
  }
  if (axes_ > 0) {
    std::ranges::copy(weight_images(particles_), least.end() - 2);
  } else if (particles_.count > 0) {
    const auto [lo, hi] = std::minmax_element(particles_.id, particles_.id + particles_.count);
    least[0] = static_cast<std::uint64_t>(*lo);
    least[geometry::kDimsMax] = ~static_cast<std::uint64_t>(*hi);
  }
  comm_.all_min(least);
  const bool none = least[0] == kNoImage;
  for (std::size_t a = 0; a < at(axes_) && !none; ++a) {
    lo_[a] = geometry::value_of_image(least[a]);
    hi_[a] = geometry::value_of_image(~least[geometry::kDimsMax + a]);
  }
  id_lo_ = axes_ == 0 && !none ? static_cast<Id>(least[0]) : 0;
  id_hi_ = axes_ == 0 && !none ? static_cast<Id>(~least[geometry::kDimsMax]) : 0;
  level_.resize(start_ == nullptr ? 1 : start_->roots.size());
  std::vector<std::uint64_t> sums = sample_maps();
  const std::size_t samples = sums.size();
  for (std::size_t r = 0; r < level_.size(); ++r) sums.push_back(root_end(r) - root_begin(r));
  comm_.all_sum(sums);
  result_.reductions += 2;
  choose_maps(sums);
  std::uint64_t count = settled_ == nullptr ? 0 : settled_->counts_upto.back();
  for (std::size_t r = 0; r < level_.size(); ++r) {
    level_[r].range = start_ == nullptr ? result_.tree.root() : start_->roots[r];
    level_[r].count = sums[samples + r];
    result_.searched += sums[samples + r];
  }
  count += result_.searched;
  if (start_ == nullptr || start_->rule == nullptr) {
    geometry::Box all = settled_ == nullptr ? geometry::Box{} : settled_->box(0, options_.parts);
    if (!none) all.extend(lo_, axes_), all.extend(hi_, axes_);
    Point extents{};
    for (std::size_t a = 0; a < at(axes_) && count > 0; ++a) extents[a] = geometry::extent(all.lo[a], all.hi[a]);
    rule_.set_all(count, extents);
  }
  if (level_.size() == 1)
    for (std::size_t a = 0; a < q_axes_ && !none; ++a) {
      level_[0].bounds.lo[a] = axes_ == 0 ? maps_[a](id_lo_) : maps_[a](lo_[a]);
      level_[0].bounds.hi[a] = axes_ == 0 ? maps_[a](id_hi_) : maps_[a](hi_[a]);
    }
  if (start_ == nullptr)
    if (const auto range = weight_range_of_images(std::span<const std::uint64_t>(least).last<2>()))
      scale_.emplace(range->largest, count);
  if (scale_) weigh_roots();
}

void TreeBuilder::weigh_roots() {
  std::vector<u128> weights(level_.size(), 0);
  for (std::size_t r = 0; r < level_.size(); ++r)
    for (std::size_t i = root_begin(r); i < root_end(r); ++i) weights[r] += (*scale_)(particles_.weight[i]);
  all_sum_wide(comm_, weights);
  ++result_.reductions;
  for (std::size_t r = 0; r < level_.size(); ++r) level_[r].weight = weights[r];
}

// Some of the particles. Where the answer depends on the map, since cuts lie between its bins, they must be the same
// ones however the particles are dealt out: those of every 64th id, at random.
std::vector<std::size_t> TreeBuilder::sampled_slots() const {
  std::vector<std::size_t> slots;
  if (options_.cut_tolerance > 0) {
    for (std::size_t i = 0; i < particles_.count; ++i)
      if (mix64(static_cast<std::uint64_t>(particles_.id[i])) % 64 == 0) slots.push_back(i);
    return slots;
  }
  const std::size_t stride = std::max<std::size_t>(particles_.count / kSampleMax, 1);
  for (std::size_t i = 0; i < particles_.count; i += stride) slots.push_back(i);
  return slots;
}

// How they spread over an axis, in equal steps of the value and of the image: where the former puts
// most of them into one place, and the latter doesn't, the image suits the axis (many decades of scale).
std::vector<std::uint64_t> TreeBuilder::sample_maps() const {
  // By axis: the bins of both maps, and how many ranks have a value that its integer does not tell.
  std::vector<std::uint64_t> counts(at(axes_) * kSampleWords, 0);
  const std::vector<std::size_t> slots = sampled_slots();
  std::vector<double> sample;
  for (std::size_t a = 0; a < at(axes_); ++a) {
    sample.clear();
    for (const std::size_t i : slots) sample.push_back(particles_.position[a][i]);
    const std::array maps{AxisMap::by_value(lo_[a], hi_[a]), AxisMap::by_image(lo_[a], hi_[a])};
    for (std::size_t m = 0; m < maps.size(); ++m) {
      const auto top = static_cast<std::uint64_t>(std::max(maps[m](hi_[a]), 1));
      for (const double x : sample)
        ++counts[a * kSampleWords + m * kSampleBins + static_cast<std::uint64_t>(maps[m](x)) * (kSampleBins - 1) / top];
    }
    if (maps[0].even() && zeros_of_told(maps[0], sample) < 0) ++counts[(a + 1) * kSampleWords - 1];
  }
  return counts;
}

void TreeBuilder::choose_maps(std::span<const std::uint64_t> samples) {
  if (axes_ == 0) maps_[0] = AxisMap::of_ids(id_lo_, id_hi_);
  for (std::size_t a = 0; a < at(axes_); ++a) {
    const auto most = [&](std::size_t m) {
      return std::ranges::max(samples.subspan(a * kSampleWords + m * kSampleBins, kSampleBins));
    };
    maps_[a] = most(0) > 2 * most(1) ? AxisMap::by_image(lo_[a], hi_[a]) : AxisMap::by_value(lo_[a], hi_[a]);
    told_[a] = maps_[a].even() && samples[(a + 1) * kSampleWords - 1] == 0 ? 1 : 0;
  }
}

// Axes whose integers may tell the coordinates are found to do so, or not, while the records are made.
void TreeBuilder::make_records() {
  const bool tell = std::ranges::max(told_) != 0 &&
                    std::all_of(maps_.begin(), maps_.begin() + axes_, [](const AxisMap& map) { return map.even(); });
  const std::array<int, geometry::kDimsMax> zeros =
      records_.build(particles_, axes_, maps_, options_.limits.chunk_max, tell);
  if (!tell) return;
  // One more than the zeros; 0 where they don't.
  for (std::size_t a = 0; a < told_.size(); ++a)
    told_[a] = told_[a] == 0 ? 0 : static_cast<std::uint64_t>(zeros[a] + 1);
  comm_.all_min(told_);
  ++result_.reductions;
  for (std::size_t a = 0; a < at(axes_); ++a)
    if (told_[a] != 0) maps_[a].set_exact(static_cast<unsigned>(told_[a] - 1));
}

void TreeBuilder::lay_out_roots() {
  for (const Span& span : records_.spans()) {
    spans_.push_back(span);
    starts_.push_back(span.first);
  }
  const std::size_t chunks = starts_.size();
  ends_.resize(chunks * at(options_.parts));
  if (level_.size() == 1) return;
  const std::vector<Span> whole = std::move(spans_);
  spans_.clear();
  for (std::size_t r = 0; r < level_.size(); ++r)
    for (const Span& span : whole) {
      const auto within = [&span](std::size_t particle) {
        return span.first + std::clamp<std::size_t>(particle, span.base, span.base + span.size()) - span.base;
      };
      Record* const first = within(root_begin(r));
      Record* const last = within(root_end(r));
      spans_.push_back({first, first, last, last, nullptr, nullptr, span.base});
      widen(level_[r].bounds, {first, last});
    }
  reduce_bounds(level_);
}

}  // namespace rcb::partition
