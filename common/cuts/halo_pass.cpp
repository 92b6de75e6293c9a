#include "common/cuts/halo_pass.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

#include <fmt/format.h>

namespace rcb::cuts {
namespace {

// At most the width of all particles of one table, and at least half of it.
double table_width(double width, bool each) {
  if (!each || width == 0) return width;
  return std::min(std::ldexp(1.0, std::ilogb(width) + 1), std::numeric_limits<double>::max());
}

}  // namespace

HaloPass::HaloPass(const OwnerTables& tables, const Reach& reach, const Positions& positions,
                   const HaloOptions& options)
    : reach_(reach),
      options_(options),
      targets_{tables.tree.parts, options.seats},
      owners_(tables, positions, options.ids, options.last_part),
      within_(options.near.norm, options.near.width),
      counts_(at(targets_.count()), 0) {}

Status HaloPass::run(std::size_t begin, std::size_t end) {
  for (std::size_t first = begin; first < end; first += Batch::kMost)
    if (Status status = add_batch(first, std::min(Batch::kMost, end - first)); !status) return status;
  for (const HaloEntry& entry : entries()) ++counts_[at(entry.target)];
  return {};
}

Status HaloPass::add_batch(std::size_t begin, std::size_t count) {
  if (Status status = owners_.read(begin, count, part_.data()); !status) return status;
  const bool each = !options_.widths.empty();
  HaloTable* const table = each ? nullptr : table_for(options_.near.width);
  const Fence* const fence = each || owners_.uniform() < 0 ? nullptr : table->fence(owners_.uniform());
  if (fence == nullptr) {
    for (std::size_t i = 0; i < count; ++i)
      if (Status status = add_row(begin, i); !status) return status;
    return {};
  }
  const geometry::Box inner = fence->inner;
  for (std::size_t first = 0; first < count; first += 64) {
    std::uint64_t outside = 0;
    for (std::size_t a = 0; a < at(reach_.dims()); ++a)
      outside |=
          outside_of({owners_.x()[a] + first, std::min<std::size_t>(64, count - first)}, inner.lo[a], inner.hi[a]);
    for (; outside != 0; outside &= outside - 1)
      if (Status status = add_row(begin, first + at(std::countr_zero(outside))); !status) return status;
  }
  return {};
}

Status HaloPass::add_row(std::size_t begin, std::size_t i) {
  const std::uint64_t row = begin + i;
  double width = options_.near.width;
  if (!options_.widths.empty()) {
    width = options_.widths[row];
    Near near = options_.near;
    near.width = width;
    if (Status status = near.check(reach_.dims()); !status) return about(row, status);
    within_ = Within(near.norm, width);
  }
  Point x{};
  for (std::size_t a = 0; a < at(reach_.dims()); ++a) x[a] = owners_.x()[a][i];
  HaloTable* const table = table_for(width);
  const Fence* const fence = table == nullptr ? nullptr : table->fence(part_[i]);
  const int faces = fence == nullptr ? Fence::kOutside : fence->faces(x, at(reach_.dims()));
  if (faces == 0) return {};
  if (faces == Fence::kOutside) return add_by_reach(row, x, part_[i], width);
  const std::span<const Candidate> candidates = table->candidates(part_[i], faces);
  if (Status status = reserve(candidates.size()); !status) return status;
  const std::size_t first = size_;
  for (const Candidate& one : candidates) {
    const Point& by = images_[one.image].by;
    const geometry::Box& region = reach_.region(one.part);
    Point gaps{};
    for (std::size_t a = 0; a < at(reach_.dims()); ++a) gaps[a] = gap_of(region, a, x[a] + by[a], x[a] + by[a]);
    if (within_(gaps)) append(row, one, first);
  }
  return {};
}

Status HaloPass::about(std::uint64_t row, const Status& status) const {
  const std::string name = options_.ids.empty() ? fmt::format("row {}", row) : fmt::format("id {}", options_.ids[row]);
  return {status.code(), name + ": " + status.message(), status.hint()};
}

// first: where the row's entries begin. Several parts of a seat may need the same image; they stand one after another.
void HaloPass::append(std::uint64_t row, const Candidate& found, std::size_t first) {
  if (size_ > first && entries_[size_ - 1].target == found.target && entries_[size_ - 1].image == found.image) return;
  entries_[size_++] = {row, found.target, found.image};
}

Status HaloPass::reserve(std::size_t more) {
  if (size_ + more <= entries_.size()) return {};
  const std::size_t grown = std::max(size_ + more, size_ * 2 + 4096);
  if (size_ + more > options_.entries_max || !entries_.try_reserve(grown))
    return {Code::too_large, fmt::format("a halo of more than {} entries", size_),
            "give a smaller width, or fewer particles at a time"};
  entries_.resize(grown);
  return {};
}

Status HaloPass::add_by_reach(std::uint64_t row, const Point& x, std::int32_t part, double width) {
  if (Status status = reached_by(reach_, targets_, {x, x}, part, width, images_, found_); !status)
    return about(row, status);
  if (Status status = reserve(found_.size()); !status) return status;
  const std::size_t first = size_;
  for (const Candidate& one : found_) append(row, one, first);
  return {};
}

HaloTable* HaloPass::table_for(double width) {
  const bool each = !options_.widths.empty();
  const int key = !each || width == 0 ? std::numeric_limits<int>::min() : std::ilogb(width);
  const auto found = tables_.find(key);
  if (found != tables_.end()) return &found->second;
  if (tables_.size() == kTablesMost) return nullptr;
  return &tables_.try_emplace(key, reach_, targets_, table_width(width, each), images_).first->second;
}

}  // namespace rcb::cuts
