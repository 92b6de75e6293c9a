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
      periodic_(options.near.box.any(reach.dims())),
      counts_(at(targets_.count()), 0) {}

Status HaloPass::run(std::size_t begin, std::size_t end) {
  for (std::size_t first = begin; first < end; first += Batch::kMost)
    if (Status status = add_batch(first, std::min(Batch::kMost, end - first)); !status) return status;
  for (const HaloEntry& entry : entries()) ++counts_[at(entry.target)];
  return {};
}

Status HaloPass::add_batch(std::size_t begin, std::size_t count) {
  if (Status status = owners_.read(begin, count, part_.data()); !status) return status;
  if (!reserve(0)) return failure_;
  if (!options_.widths.empty()) return add_each(begin, count) ? Status() : failure_;
  const double width = options_.near.width;
  HaloTable* const table = table_for(width);
  const std::size_t boundary = find_boundary(count, *table);
  for (std::size_t k = 0; k < boundary; ++k) {
    const std::size_t i = boundary_[k];
    if (!add_row(begin + i, owners_.point(i), part_[i], table, faces_[k], width)) return failure_;
  }
  return {};
}

// The rows that may be in a halo, and which faces of their parts they are near. Apart from what is then done with them,
// since nobody could predict which row is one.
std::size_t HaloPass::find_boundary(std::size_t count, HaloTable& table) {
  std::size_t found = 0;
  const std::int32_t uniform = owners_.uniform();
  const Fence* const fence = uniform < 0 ? nullptr : table.fence(uniform);
  for (std::size_t first = 0; fence != nullptr && first < count; first += OwnerPass::kWord) {
    std::uint64_t outside = 0;
    for (std::size_t a = 0; a < at(reach_.dims()); ++a)
      outside |= outside_of({owners_.x()[a] + first, std::min(OwnerPass::kWord, count - first)}, fence->inner.lo[a],
                            fence->inner.hi[a]);
    for (; outside != 0; outside &= outside - 1)
      boundary_[found++] = static_cast<std::uint16_t>(first + at(std::countr_zero(outside)));
  }
  if (fence != nullptr) {
    for (std::size_t k = 0; k < found; ++k) faces_[k] = faces_of(*fence, owners_.point(boundary_[k]));
    return found;
  }
  for (std::size_t i = 0; i < count; ++i) {
    const Fence* const own = table.fence(part_[i]);
    boundary_[found] = static_cast<std::uint16_t>(i);
    faces_[found] = own == nullptr ? kByReach : faces_of(*own, owners_.point(i));
    found += static_cast<std::size_t>(faces_[found] != 0);
  }
  return found;
}

std::uint8_t HaloPass::faces_of(const Fence& fence, const Point& x) const {
  return periodic_ && !fence.holds(x) ? kByReach : fence.faces(x);
}

bool HaloPass::add_each(std::size_t begin, std::size_t count) {
  Near near = options_.near;
  for (std::size_t i = 0; i < count; ++i) {
    near.width = options_.widths[begin + i];
    if (Status status = near.check(reach_.dims()); !status) return fail(begin + i, status);
    HaloTable* const table = table_for(near.width);
    const Fence* const fence = table == nullptr ? nullptr : table->fence(part_[i]);
    const std::uint8_t faces = fence == nullptr ? kByReach : faces_of(*fence, owners_.point(i));
    if (faces != 0 && !add_row(begin + i, owners_.point(i), part_[i], table, faces, near.width)) return false;
  }
  return true;
}

bool HaloPass::add_row(std::uint64_t row, const Point& x, std::int32_t part, HaloTable* table, std::uint8_t faces,
                       double width) {
  if (faces == kByReach) return add_by_reach(row, x, part, width);
  const std::span<const Candidate> candidates = table->candidates(part, faces);
  if (!reserve(candidates.size())) return false;
  const Within within(options_.near.norm, width);
  // Without branches, which nobody could predict: an entry that is none is overwritten by the next one.
  const Within::Lanes lanes(x);
  HaloEntry* to = entries_.data() + size_;
  std::int32_t last_target = -1;
  std::int32_t last_image = -1;
  for (const Candidate& one : candidates) {
    // Several parts of a seat may need the same image; they stand one after another.
    const bool is = within.near(reach_.bounds(one.part), lanes + Within::Lanes(images_[one.image].by)) &
                    ((one.target != last_target) | (one.image != last_image));
    last_target = is ? one.target : last_target;
    last_image = is ? one.image : last_image;
    *to = {row, one.target, one.image};
    to += static_cast<std::ptrdiff_t>(is);
  }
  size_ = static_cast<std::size_t>(to - entries_.data());
  return true;
}

bool HaloPass::fail(std::uint64_t row, const Status& status) {
  const std::string name = options_.ids.empty() ? fmt::format("row {}", row) : fmt::format("id {}", options_.ids[row]);
  failure_ = {status.code(), name + ": " + status.message(), status.hint()};
  return false;
}

bool HaloPass::grow(std::size_t more) {
  const std::size_t grown = std::max(size_ + more + 1, size_ * 2 + 4096);
  if (size_ + more > options_.entries_max || !entries_.try_reserve(grown)) {
    failure_ = {Code::too_large, fmt::format("a halo of more than {} entries", size_ - 1),
                "give a smaller width, or fewer particles at a time"};
    return false;
  }
  entries_.resize(grown);
  entries_[0] = {UINT64_MAX, -1, -1};
  return true;
}

bool HaloPass::add_by_reach(std::uint64_t row, const Point& x, std::int32_t part, double width) {
  if (Status status = reached_by(reach_, targets_, {x, x}, part, width, images_, found_); !status)
    return fail(row, status);
  if (!reserve(found_.size())) return false;
  for (const Candidate& one : found_) {
    const HaloEntry& last = entries_[size_ - 1];
    if (last.row != row || last.target != one.target || last.image != one.image)
      entries_[size_++] = {row, one.target, one.image};
  }
  return true;
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
