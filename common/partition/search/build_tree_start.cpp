// The start of a build: bounds and counts of all particles, the maps from coordinates to integers, the quantised points
// of the roots.
#include <algorithm>
#include <numeric>

#include "common/base/count_groups.hpp"
#include "common/base/index.hpp"
#include "common/base/random.hpp"
#include "common/comm/wide_sum.hpp"
#include "common/partition/balance/bounding_box.hpp"
#include "common/partition/search/build_tree.hpp"
#include "common/partition/search/outermost.hpp"

namespace rcb::partition {
namespace {

constexpr std::size_t kMapSampleMax = 256;  // particles per rank, sampled to choose a map
constexpr std::size_t kSampleBins = 512;
constexpr std::size_t kSampleWords = 2 * kSampleBins + 1;

}  // namespace

std::vector<std::uint64_t> TreeBuilder::find_roots() {
  if (start_.roots[0].parts() == options_.parts) return {particles_.count};
  root_of_ = roots_of_parts(start_.roots, options_.parts);
  const std::vector<std::uint64_t> counts =
      count_groups([this](std::size_t i) { return start_.part[i]; }, at(options_.parts), start_.part.size());
  result_.traffic.bytes += start_.part.size_bytes();
  std::vector<std::uint64_t> of_roots;
  for (const NodeRange& root : start_.roots)
    of_roots.push_back(std::accumulate(counts.begin() + root.first, counts.begin() + root.last, std::uint64_t{0}));
  all_particles_ = std::accumulate(of_roots.begin(), of_roots.end(), std::size_t{0}) == particles_.count;
  if (of_roots.size() > 1 || !all_particles_) roots_ = {of_roots.size(), start_.part, root_of_};
  return of_roots;
}

geometry::Box TreeBuilder::own_box() {
  result_.traffic.reads += particles_.count;
  result_.traffic.bytes +=
      particles_.count * at(axes_) * (sizeof(double) + (all_particles_ ? 0 : sizeof(std::int32_t)));
  if (sampled()) {
    gather_outermost_if_open(comm_, particles_, options_, start_.stride, start_.sample, result_);
    splitters_ = share_splitters(comm_, start_.sample, options_, axes_);
    ++result_.reductions;
    auto* const bytes = reinterpret_cast<std::uint8_t*>(start_.part.data());
    bucket_ = {bytes + particles_.count * (sizeof(std::int32_t) - 1), particles_.count};
  } else if (start_.splitters != nullptr) {
    splitters_ = *start_.splitters;
    own_bucket_.resize(particles_.count);
    bucket_ = own_bucket_.span();
  }
  if (bucketed()) {
    result_.traffic.bytes += bucket_.size();
    return sort_into_buckets(particles_, *splitters_, bucket_);
  }
  geometry::Box box;
  for (std::size_t a = 0; a < at(axes_); ++a) {
    const double* const x = particles_.position[a];
    if (all_particles_) geometry::least_and_most({x, particles_.count}, box.lo[a], box.hi[a]);
    for (std::size_t i = 0; i < particles_.count && !all_particles_; ++i) {
      const bool within = roots_.of(i) != Roots::kNone;
      box.lo[a] = within ? std::min(box.lo[a], x[i]) : box.lo[a];
      box.hi[a] = within ? std::max(box.hi[a], x[i]) : box.hi[a];
    }
  }
  return box;
}

void TreeBuilder::find_box() {
  if (interior_ != nullptr) {
    (void)own_box();  // for the buckets
    box_ = interior_->boundary;
    return;
  }
  box_ = own_box();
  std::array<std::uint64_t, 2> weights = weight_order_bits(particles_);
  extend_by_all(comm_, {&box_, 1}, axes_, weights);
  ++result_.reductions;
  if (start_.rule == nullptr) greatest_weight_ = greatest_weight(weights);
}

void TreeBuilder::measure_all() {
  const std::vector<std::uint64_t> counts = find_roots();
  find_box();
  level_.resize(start_.roots.size());
  std::vector<std::uint64_t> sums = sample_maps();
  const std::size_t samples = sums.size();
  sums.insert(sums.end(), counts.begin(), counts.end());
  comm_.all_sum(sums);
  ++result_.reductions;
  choose_maps(sums);
  std::uint64_t count = interior_ == nullptr ? 0 : interior_->count_prefix.back();
  for (std::size_t r = 0; r < level_.size(); ++r) {
    level_[r].range = start_.roots[r];
    level_[r].count = sums[samples + r];
    result_.searched += sums[samples + r];
  }
  count += result_.searched;
  if (start_.rule == nullptr) {
    geometry::Box all = interior_ == nullptr ? geometry::Box{} : interior_->box(0, options_.parts);
    all.extend(box_);
    Point extents{};
    for (std::size_t a = 0; a < at(axes_) && count > 0; ++a) extents[a] = geometry::extent(all.lo[a], all.hi[a]);
    rule_.set_all(count, extents);
  }
  if (level_.size() == 1 && !box_.empty(axes_))
    for (std::size_t a = 0; a < at(axes_); ++a) {
      level_[0].bounds.lo[a] = maps_[a](box_.lo[a]);
      level_[0].bounds.hi[a] = maps_[a](box_.hi[a]);
    }
  if (greatest_weight_) scale_.emplace(*greatest_weight_, count);
  if (scale_) weigh_roots();
}

void TreeBuilder::weigh_roots() {
  std::vector<u128> weights(level_.size(), 0);
  result_.traffic.bytes += particles_.count * sizeof(double);
  for (std::size_t i = 0; i < particles_.count; ++i)
    if (const std::int32_t root = roots_.of(i); root != Roots::kNone)
      weights[at(root)] += (*scale_)(particles_.weight[i]);
  comm::all_sum_wide(comm_, weights);
  ++result_.reductions;
  for (std::size_t r = 0; r < level_.size(); ++r) level_[r].weight = weights[r];
}

// The slots of a sample. With a cut tolerance cuts lie between a map's bins, so the tree depends on the map: the sample
// must then be the same however the particles are distributed, hence one id of 64, chosen by a hash.
std::vector<std::size_t> TreeBuilder::sampled_slots() const {
  std::vector<std::size_t> slots;
  if (options_.cut_tolerance > 0) {
    for (std::size_t i = 0; i < particles_.count; ++i)
      if (mix64(static_cast<std::uint64_t>(particles_.id_of(i))) % 64 == 0 && roots_.of(i) != Roots::kNone)
        slots.push_back(i);
    return slots;
  }
  const std::size_t stride = std::max<std::size_t>(particles_.count / kMapSampleMax, 1);
  for (std::size_t i = 0; i < particles_.count; i += stride)
    if (roots_.of(i) != Roots::kNone) slots.push_back(i);
  return slots;
}

// Histograms of the sample on each axis, in equal steps of the value and of the order-preserving bits. Where the former
// puts most particles into one bin and the latter doesn't, the latter suits the axis (many decades of scale).
std::vector<std::uint64_t> TreeBuilder::sample_maps() const {
  // By axis: the bins of both maps, then the number of ranks on whose sample the map by value isn't lossless.
  std::vector<std::uint64_t> counts(at(axes_) * kSampleWords, 0);
  const std::vector<std::size_t> slots = sampled_slots();
  std::vector<double> sample;
  for (std::size_t a = 0; a < at(axes_); ++a) {
    sample.clear();
    for (const std::size_t i : slots) sample.push_back(particles_.position[a][i]);
    const std::array maps{AxisMap::by_value(box_.lo[a], box_.hi[a]), AxisMap::by_order_bits(box_.lo[a], box_.hi[a])};
    for (std::size_t m = 0; m < maps.size(); ++m) {
      const auto top = static_cast<std::uint64_t>(std::max(maps[m](box_.hi[a]), 1));
      for (const double x : sample)
        ++counts[a * kSampleWords + m * kSampleBins + static_cast<std::uint64_t>(maps[m](x)) * (kSampleBins - 1) / top];
    }
    if (maps[0].linear() && zeros_of_lossless(maps[0], sample) < 0) ++counts[(a + 1) * kSampleWords - 1];
  }
  return counts;
}

void TreeBuilder::choose_maps(std::span<const std::uint64_t> samples) {
  for (std::size_t a = 0; a < at(axes_); ++a) {
    const auto most = [&](std::size_t m) {
      return std::ranges::max(samples.subspan(a * kSampleWords + m * kSampleBins, kSampleBins));
    };
    maps_[a] = most(0) > 2 * most(1) ? AxisMap::by_order_bits(box_.lo[a], box_.hi[a])
                                     : AxisMap::by_value(box_.lo[a], box_.hi[a]);
    lossless_[a] = maps_[a].linear() && samples[(a + 1) * kSampleWords - 1] == 0 ? 1 : 0;
  }
}

// For axes that are lossless in the sample, the pass that quantises checks all particles.
void TreeBuilder::quantise() {
  const bool tell = std::ranges::max(lossless_) != 0 &&
                    std::all_of(maps_.begin(), maps_.begin() + axes_, [](const AxisMap& map) { return map.linear(); });
  const std::array<int, geometry::kDimsMax> zeros =
      points_.build(particles_, maps_, options_.limits.chunk_max, tell, roots_, bucket_);
  result_.traffic.reads += particles_.count;
  result_.traffic.bytes +=
      particles_.count * (at(axes_) * sizeof(double) + (roots_.one() ? 0 : 2 * sizeof(std::int32_t))) +
      2 * bucket_.size() + points_.size() * sizeof(QuantisedPoint);
  if (!tell) return;
  // 1 + the trailing zeros; 0 if the axis is not lossless.
  for (std::size_t a = 0; a < lossless_.size(); ++a)
    lossless_[a] = lossless_[a] == 0 ? 0 : static_cast<std::uint64_t>(zeros[a] + 1);
  comm_.all_min(lossless_);
  ++result_.reductions;
  for (std::size_t a = 0; a < at(axes_); ++a)
    if (lossless_[a] != 0) maps_[a].set_lossless(static_cast<unsigned>(lossless_[a] - 1));
}

void TreeBuilder::lay_out_roots() {
  spans_ = points_.spans();
  const std::size_t chunks = points_.chunks();
  for (std::size_t r = 0; r < level_.size(); ++r) {
    level_[r].spans_first = r * chunks;
    level_[r].spans_last = (r + 1) * chunks;
  }
  if (bucketed()) {
    for (std::size_t n = 0; n < spans_.size(); ++n) spans_[n].bucket = static_cast<std::int32_t>(n / chunks);
    writer_.use_buckets(bucket_, options_.limits.chunk_max);
    std::erase_if(spans_, [](const Span& span) { return span.size() == 0; });
    level_[0].spans_last = spans_.size();
    level_[0].sampled = start_.sample.all();
  } else if (level_.size() == 1) {
    return;
  }
  for (Node& node : level_)
    for (Span& span : spans_of(node)) {
      widen(span.bounds, span.all());
      node.bounds.extend(span.bounds);
    }
  result_.traffic.bytes += points_.size() * sizeof(QuantisedPoint);
  if (level_.size() > 1) reduce_bounds(level_);
}

}  // namespace rcb::partition
