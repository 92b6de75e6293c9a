#include "server/service/push/member_slices.hpp"

#include <algorithm>
#include <numeric>
#include <optional>

#include <fmt/format.h>

#include "common/base/axis_names.hpp"
#include "common/layout/layout.hpp"
#include "server/service/context/collective.hpp"
#include "server/service/push/shared_source.hpp"

namespace rcb::service {

using api::Moved;

namespace {

// Number of particles on this rank by the member whose parts they are in.
std::vector<std::uint64_t> counts_by_member(const Scene& scene, const layout::PartRange& parts, int members) {
  std::vector<std::uint64_t> counts(static_cast<std::size_t>(members), 0);
  for (int p = parts.begin; p < parts.end; ++p) {
    const int member = layout::rank_of_part(p, scene.options.parts, members);
    counts[static_cast<std::size_t>(member)] += scene.loads.counts[static_cast<std::size_t>(p)];
  }
  return counts;
}

// Where a member's values for this rank come from, slot after slot.
class Feed {
 public:
  // Errors: those of SharedSource.
  static Result<Feed> open(const PushSlice& slice, int dims) {
    Feed feed;
    feed.slice_ = &slice;
    if (slice.shared.empty()) return feed;
    auto source = SharedSource::open(slice, dims);
    if (!source.ok()) return source.status();
    feed.source_ = std::move(*source);
    feed.rows_.resize(slice.count);
    if (Status status = feed.source_->rows(feed.rows_.data()); !status.ok()) return status;
    return feed;
  }

  // Array number a, of which the axes are the first.
  void begin(std::size_t a, std::size_t dims) {
    next_ = 0;
    if (!source_) {
      values_ = reinterpret_cast<const double*>(slice_->arrays[a].bytes.data());
      return;
    }
    if (copied_.size() != slice_->count) copied_.resize(slice_->count);
    a < dims ? source_->positions(a, rows_.span(), copied_.data()) : source_->weights(rows_.span(), copied_.data());
    values_ = copied_.data();
  }
  double next() { return values_[next_++]; }

 private:
  const PushSlice* slice_ = nullptr;
  std::optional<SharedSource> source_;
  Buffer<particles::Id> rows_;
  Buffer<double> copied_;
  const double* values_ = nullptr;
  std::size_t next_ = 0;
};

bool has_arrays(const PushSlice& slice, const ArrayTypes& types) {
  if (!slice.shared.empty()) return slice.shared.size() == types.size() + 1;  // and the rows
  bool fits = slice.arrays.size() == types.size();
  for (const wire::Array& array : slice.arrays) fits = fits && array.bytes.size() == slice.count * 8;
  return fits;
}

std::span<const std::uint64_t> slots_of(const PushSlice& slice) {
  return {reinterpret_cast<const std::uint64_t*>(slice.arrays.back().bytes.data()), slice.count};
}

// Checks the slice of a member that brings few: x (y, z) and ascending slots of particles of its parts.
Status check_few(const Scene& scene, const PushSlice& slice, int members) {
  bool fits = slice.shared.empty() && slice.arrays.size() == static_cast<std::size_t>(scene.options.dims) + 1 &&
              slice.arrays.back().name == "slot";
  for (const wire::Array& array : slice.arrays) fits = fits && array.bytes.size() == slice.count * 8;
  if (!fits)
    return {Code::invalid_argument,
            fmt::format("the few particles of member {} must have x (y, z) and slot", slice.member)};
  const auto slots = slots_of(slice);
  for (std::size_t k = 0; k < slots.size(); ++k) {
    if (k > 0 && slots[k] <= slots[k - 1])
      return {Code::invalid_argument,
              fmt::format("member {}: slot {} follows slot {}", slice.member, slots[k], slots[k - 1]),
              "slots are ascending, each once"};
    if (slots[k] >= scene.part.size() ||
        layout::rank_of_part(scene.part[slots[k]], scene.options.parts, members) != slice.member)
      return {Code::stale_plan, fmt::format("slot {} isn't that of a particle of member {}", slots[k], slice.member),
              "push this step in order \"id\""};
  }
  return {};
}

}  // namespace

Status join_few_of_members(const comm::Comm& comm, const Scene& scene, int members, std::vector<PushSlice>& slices) {
  const auto dims = static_cast<std::size_t>(scene.options.dims);
  PushSlice whole{.rank = comm.rank()};
  Buffer<std::uint64_t> slots;
  std::array<Buffer<double>, 3> position;
  for (const PushSlice& slice : slices) {
    if (Status status = check_few(scene, slice, members); !status.ok()) return status;
    whole.count += slice.count;
    slots.append(slots_of(slice));
    for (std::size_t a = 0; a < dims; ++a)
      position[a].append({reinterpret_cast<const double*>(slice.arrays[a].bytes.data()), slice.count});
  }
  Buffer<std::uint64_t> order(slots.size());
  std::iota(order.begin(), order.end(), std::uint64_t{0});
  std::sort(order.begin(), order.end(), [&slots](auto a, auto b) { return slots[a] < slots[b]; });
  Buffer<std::byte> spare;
  for (std::size_t a = 0; a < dims; ++a) {
    put_in_order(position[a], order, spare);
    whole.arrays.push_back({kAxisNames[a], "<f8", {whole.count}, position[a].release_as<std::byte>()});
  }
  put_in_order(slots, order, spare);
  whole.arrays.push_back({"slot", "<u8", {whole.count}, slots.release_as<std::byte>()});
  slices.clear();
  slices.push_back(std::move(whole));
  return {};
}

Result<bool> join_member_slices(const comm::Comm& comm, const Scene& scene, std::span<const Moved> moved_by,
                                const ArrayTypes& types, std::array<Buffer<double>, 3>& room,
                                std::vector<PushSlice>& slices) {
  const int rank = comm.rank();
  const int members = static_cast<int>(moved_by.size());
  std::vector<PushSlice> few;
  for (PushSlice& slice : slices)
    if (moved_by[static_cast<std::size_t>(slice.member)] == Moved::some) few.push_back(std::move(slice));
  std::erase_if(slices,
                [&](const PushSlice& s) { return moved_by[static_cast<std::size_t>(s.member)] == Moved::some; });
  for (const PushSlice& slice : few)
    if (Status status = check_few(scene, slice, members); !status.ok()) return status;
  const auto dims = static_cast<std::size_t>(scene.options.dims);
  const auto [first_part, end_part] = layout::parts_of_rank(rank, scene.options.parts, comm.size());
  std::vector<std::uint64_t> missing = counts_by_member(scene, {first_part, end_part}, members);
  std::vector<std::size_t> slice_of(static_cast<std::size_t>(members), slices.size());  // slices.size(): none
  bool fits = true;
  for (std::size_t s = 0; s < slices.size() && fits; ++s) {
    const auto member = static_cast<std::size_t>(slices[s].member);
    fits = member < missing.size() && has_arrays(slices[s], types) && missing[member] == slices[s].count;
    if (fits) missing[member] = 0;
    if (fits) slice_of[member] = s;
  }
  for (std::size_t k = 0; k < missing.size(); ++k) fits = fits && (missing[k] == 0 || moved_by[k] != Moved::all);
  if (!fits)
    return Status(Code::stale_plan,
                  fmt::format("what the members bring to rank {} isn't what their parts have there", rank),
                  "push this step in order \"id\"");
  PushSlice whole{.rank = rank, .count = scene.part.size()};
  if (slices.size() == 1 && slices.front().count == whole.count && slices.front().shared.empty()) return false;
  std::vector<std::size_t> slice_of_part;
  for (int p = first_part; p < end_part; ++p)
    slice_of_part.push_back(slice_of[static_cast<std::size_t>(layout::rank_of_part(p, scene.options.parts, members))]);
  std::vector<Feed> feeds;
  for (const PushSlice& slice : slices) {
    auto feed = Feed::open(slice, scene.options.dims);
    if (!feed.ok())
      return Status(feed.status().code(), fmt::format("member {}: {}", slice.member, feed.status().message()),
                    feed.status().hint());
    feeds.push_back(std::move(*feed));
  }
  for (std::size_t a = 0; a < types.size(); ++a) {
    const bool axis = a < dims;  // if weights come, all members bring all their particles
    Buffer<double> joined;
    if (axis) joined.swap(room[a]);
    if (!joined.try_reserve(whole.count))
      return Status(Code::too_large, fmt::format("rank {} has no memory for {} particles", rank, whole.count));
    joined.resize(whole.count);
    for (Feed& feed : feeds) feed.begin(a, dims);
    const double* own = axis ? scene.particles.position[a].data() : nullptr;
    for (std::size_t i = 0; i < joined.size(); ++i) {
      const std::size_t slice = slice_of_part[static_cast<std::size_t>(scene.part[i] - first_part)];
      joined[i] = slice < feeds.size() ? feeds[slice].next() : own[i];
    }
    for (const PushSlice& slice : few) {
      const auto slots = slots_of(slice);
      const auto* values = reinterpret_cast<const double*>(slice.arrays[a].bytes.data());
      for (std::size_t k = 0; k < slots.size(); ++k) joined[slots[k]] = values[k];
    }
    for (PushSlice& slice : slices)
      if (slice.shared.empty()) slice.arrays[a].bytes.release();
    whole.arrays.push_back({types[a].first, "<f8", {whole.count}, joined.release_as<std::byte>()});
  }
  slices.clear();
  slices.push_back(std::move(whole));
  return true;
}

}  // namespace rcb::service
