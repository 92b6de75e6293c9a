#include "common/cuts/halo_pass.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

#include <fmt/format.h>

namespace rcb::cuts {
namespace {

// At least the width of each particle of one table, and at most twice that.
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
  if (!grow(0)) return failure_;
  for (std::size_t first = begin; first < end; first += Batch::kMost)
    if (Status status = add_batch(first, std::min(Batch::kMost, end - first)); !status) return status;
  for (const HaloEntry& entry : entries()) ++counts_[at(entry.target)];
  return {};
}

Status HaloPass::add_batch(std::size_t begin, std::size_t count) {
  if (Status status = owners_.read(begin, count, part_.data()); !status) return status;
  begin_ = begin;
  const bool well = options_.widths.empty() ? add_all(count) : add_each(count);
  return well && test_pairs() ? Status() : failure_;
}

bool HaloPass::add_all(std::size_t count) {
  HaloTable* const table = table_for(options_.near.width);
  const std::size_t boundary = find_boundary(count, *table);
  for (std::size_t k = 0; k < boundary; ++k)
    if (!add_row(boundary_[k], table, faces_[k], options_.near.width)) return false;
  return true;
}

// The rows that may be in a halo, and which faces of their parts they are near. Apart from what is then done with them,
// since nobody could predict which row is one.
std::size_t HaloPass::find_boundary(std::size_t count, HaloTable& table) {
  std::size_t found = 0;
  const std::int32_t uniform = owners_.uniform();
  const Fence* const fence = uniform < 0 ? nullptr : table.fence(uniform);
  for (std::size_t first = 0; fence != nullptr && first < count; first += OwnerPass::kWord) {
    std::uint64_t outside = outside_of(owners_.x(first), std::min(OwnerPass::kWord, count - first), fence->inner);
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

bool HaloPass::add_each(std::size_t count) {
  Near near = options_.near;
  for (std::size_t i = 0; i < count; ++i) {
    near.width = options_.widths[begin_ + i];
    if (Status status = near.check(reach_.dims()); !status) return fail(i, status);
    HaloTable* const table = table_for(near.width);
    const Fence* const fence = table == nullptr ? nullptr : table->fence(part_[i]);
    const std::uint8_t faces = fence == nullptr ? kByReach : faces_of(*fence, owners_.point(i));
    if (faces != 0 && !add_row(i, table, faces, near.width)) return false;
  }
  return true;
}

bool HaloPass::add_row(std::size_t i, HaloTable* table, std::uint8_t faces, double width) {
  if (faces == kByReach) return test_pairs() && add_by_reach(i, width);
  const std::span<const Candidate> candidates = table->candidates(part_[i], faces);
  for (std::size_t begin = 0; begin < candidates.size(); begin += kFours) {
    // Four at a time: how many there are, nobody could predict.
    for (std::size_t k = 0; k < kFours; ++k)
      pairs_[pairs_count_ + k] = {candidates.data()[begin + k], static_cast<std::uint32_t>(i)};
    pairs_count_ += std::min(kFours, candidates.size() - begin);
    if (pairs_count_ + kFours > pairs_.size() && !test_pairs()) return false;
  }
  return true;
}

// Many at a time and without branches, which nobody could predict: an entry that is none is overwritten by the next
// one.
bool HaloPass::test_pairs() {
  if (!reserve(pairs_count_)) return false;
  const bool each = !options_.widths.empty();
  Within within(options_.near.norm, options_.near.width);
  HaloEntry* to = entries_.data() + size_;
  HaloEntry last = *(to - 1);
  for (const Pair& pair : std::span(pairs_).first(pairs_count_)) {
    if (each) within = Within(options_.near.norm, options_.widths[begin_ + pair.row]);
    const Within::Lanes image = Within::Lanes(owners_.point(pair.row)) + Within::Lanes(images_[pair.one.image].by);
    const HaloEntry entry{begin_ + pair.row, pair.one.target, pair.one.image};
    // Several parts of a seat may need the same image; they stand one after another.
    const bool is = within.near(reach_.bounds(pair.one.part), image) & (entry != last);
    *to = entry;
    to += static_cast<std::ptrdiff_t>(is);
    last = is ? entry : last;
  }
  size_ = static_cast<std::size_t>(to - entries_.data());
  pairs_count_ = 0;
  return true;
}

bool HaloPass::fail(std::size_t i, const Status& status) {
  const std::uint64_t row = begin_ + i;
  const std::string name = options_.ids.empty() ? fmt::format("row {}", row) : fmt::format("id {}", options_.ids[row]);
  failure_ = {status.code(), name + ": " + status.message(), status.hint()};
  return false;
}

bool HaloPass::grow(std::size_t more) {
  const std::size_t grown = std::max(size_ + more + 1, size_ * 2 + 4096);
  if (size_ - 1 > options_.entries_max || !entries_.try_reserve(grown)) {
    failure_ = {Code::too_large, fmt::format("a halo of more than {} entries, or no memory for it", size_ - 1),
                "give a smaller width, or fewer particles at a time"};
    return false;
  }
  entries_.resize(grown);
  entries_[0] = {UINT64_MAX, -1, -1};
  return true;
}

bool HaloPass::add_by_reach(std::size_t i, double width) {
  const Point x = owners_.point(i);
  if (Status status = reached_by(reach_, targets_, {x, x}, part_[i], width, images_, found_); !status)
    return fail(i, status);
  if (!reserve(found_.size())) return false;
  for (const Candidate& one : found_) {
    entries_[size_] = {begin_ + i, one.target, one.image};
    size_ += static_cast<std::size_t>(entries_[size_] != entries_[size_ - 1]);
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
