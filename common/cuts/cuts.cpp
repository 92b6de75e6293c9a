#include "common/cuts/cuts.hpp"

#include <algorithm>
#include <cmath>
#include <mutex>

#include <fmt/format.h>

#include "common/base/axis_names.hpp"
#include "common/cuts/calls.hpp"
#include "common/cuts/halo_pass.hpp"

namespace rcb::cuts {
namespace {

using geometry::Box;

constexpr int kSeatsMax = 1 << 24;

// Joins the entries of all shares by target; a stable order, so rows stay ascending.
Result<Halo> join(const std::vector<std::unique_ptr<HaloPass>>& shares, std::size_t targets, int dims, bool shifts,
                  std::uint64_t most) {
  Halo halo;
  halo.dims = dims;
  if (!halo.offset.try_reserve(targets + 1)) return Status(Code::too_large, "no memory for a halo's lists");
  halo.offset.resize(targets + 1);
  std::uint64_t entries = 0;
  std::vector<std::vector<std::uint64_t>> next(shares.size(), std::vector<std::uint64_t>(targets));
  for (std::size_t t = 0; t < targets; ++t) {
    halo.offset[t] = entries;
    for (std::size_t k = 0; k < shares.size(); ++k) {
      next[k][t] = entries;
      entries += shares[k]->counts()[t];
    }
  }
  halo.offset[targets] = entries;
  if (entries > most || !halo.row.try_reserve(entries) || (shifts && !halo.shift.try_reserve(entries * at(dims))))
    return Status(Code::too_large, fmt::format("a halo of {} entries", entries),
                  "give a smaller width, or fewer particles at a time");
  halo.row.resize(entries);
  if (shifts) halo.shift.resize(entries * at(dims));
  static_cast<void>(share_rows(shares.size(), shares.size(), [&](std::size_t k, std::size_t, std::size_t) {
    for (const HaloEntry& entry : shares[k]->entries()) {
      const std::uint64_t to = next[k][at(entry.target)]++;
      halo.row[to] = entry.row;
      for (std::size_t a = 0; shifts && a < at(dims); ++a)
        halo.shift[to * at(dims) + a] = shares[k]->images()[entry.image].k[a];
    }
    return Status();
  }));
  return halo;
}

}  // namespace

struct Cuts::Data {
  Data(CutTree of, std::uint64_t number) : tree(std::move(of)), epoch(number), hash(tree.hash()), tables(tree) {}

  // The last one is kept, for any width: a question about every part, or at every step, has the same box again.
  std::shared_ptr<const Reach> reach(const Near& near) const {
    const std::lock_guard lock(mutex);
    if (!last_reach || last_reach->near().box != near.box || last_reach->near().norm != near.norm)
      last_reach = std::make_shared<const Reach>(tables.boxes, tree.dims, near);
    return last_reach;
  }

  CutTree tree;
  std::uint64_t epoch;
  std::uint64_t hash;
  OwnerTables tables;
  mutable std::mutex mutex;
  mutable std::shared_ptr<const Reach> last_reach;
};

Cuts::Cuts(CutTree tree, std::uint64_t epoch) : data_(std::make_shared<const Data>(std::move(tree), epoch)) {}
const CutTree& Cuts::tree() const { return data_->tree; }
std::uint64_t Cuts::epoch() const { return data_->epoch; }
std::uint64_t Cuts::hash() const { return data_->hash; }
const OwnerTables& Cuts::tables() const { return data_->tables; }
std::span<const Box> Cuts::regions() const { return data_->tables.boxes; }

Status Cuts::owner(const Positions& positions, const OwnerOptions& options, std::span<std::int32_t> part) const {
  if (Status status = check_call(tree(), positions, options); !status) return status;
  if (Status status = check_room(positions, part); !status) return status;
  return share_rows(positions.count, shares_of(positions.count, options.threads),
                    [&](std::size_t, std::size_t begin, std::size_t end) -> Status {
                      OwnerPass pass(data_->tables, positions, options.ids, options.last_part);
                      for (std::size_t first = begin; first < end; first += Batch::kMost) {
                        const std::size_t count = std::min(Batch::kMost, end - first);
                        if (pass.read_rows(first, count, &part[first])) continue;
                        if (Status status = pass.read(first, count, &part[first]); !status) return status;
                      }
                      return {};
                    });
}

Result<Halo> Cuts::halo(const Positions& positions, const HaloOptions& options) const {
  if (Status status = check_call(tree(), positions, options); !status) return status;
  if (Status status = options.near.check(dims()); !status) return status;
  if (!options.widths.empty() && options.widths.size() != positions.count)
    return bad_call(fmt::format("{} widths for {} positions", options.widths.size(), positions.count));
  if (options.seats < 0 || options.seats > kSeatsMax) return bad_call(fmt::format("{} seats", options.seats));
  return within_memory([&]() -> Result<Halo> {
    const auto kept = data_->reach(options.near);
    const Reach& reach = *kept;
    const std::size_t shares = shares_of(positions.count, options.threads);
    std::vector<std::unique_ptr<HaloPass>> passes(shares);
    const Status status = share_rows(positions.count, shares, [&](std::size_t k, std::size_t begin, std::size_t end) {
      passes[k] = std::make_unique<HaloPass>(data_->tables, reach, positions, options);
      return passes[k]->run(begin, end);
    });
    if (!status) return status;
    return join(passes, at(Targets{parts(), options.seats}.count()), dims(), options.near.box.any(dims()),
                options.entries_max);
  });
}

Result<std::vector<Neighbour>> Cuts::neighbours(int part, const Near& near) const {
  if (part < 0 || part >= parts())
    return Status(Code::not_found, fmt::format("no part {}, there are {}", part, parts()));
  if (Status status = near.check(dims()); !status) return status;
  return within_memory([&]() -> Result<std::vector<Neighbour>> {
    const auto kept = data_->reach(near);
    const Reach& reach = *kept;
    std::vector<Neighbour> found;
    if (regions()[at(part)].empty(dims())) return found;
    Images images;
    std::vector<Candidate> candidates;
    if (Status status = reached_by(reach, {parts(), 0}, reach.region(part), part, near.width, images, candidates);
        !status)
      return status;
    for (const Candidate& one : candidates) found.push_back({one.part, images[one.image].k});
    return found;
  });
}

Result<std::vector<int>> Cuts::box(const Box& box, const PeriodicBox& periodic) const {
  const Near touching{0, Norm::max, periodic};
  if (Status status = touching.check(dims()); !status) return status;
  return within_memory([&]() -> Result<std::vector<int>> {
    const auto kept = data_->reach(touching);
    const Reach& reach = *kept;
    Box asked = Reach::finite(box);
    for (std::size_t a = 0; a < at(dims()); ++a) {
      if (!(box.lo[a] <= box.hi[a]))
        return bad_call(fmt::format("{}: a box from {} to {}", kAxisNames[a], box.lo[a], box.hi[a]));
      // Images of what is longer than a period cover the axis.
      if (periodic.periodic(a) && !(box.hi[a] - box.lo[a] < periodic.length(a)))
        asked.lo[a] = periodic.lo[a], asked.hi[a] = periodic.hi[a];
    }
    std::vector<Image> images;
    if (Status status = reach.images_of(asked, 0, images); !status) return status;
    std::vector<int> found;
    for (const Image& image : images)
      reach.near(image.of(asked), Within(Norm::max, 0), [&found](int part) { found.push_back(part); });
    std::sort(found.begin(), found.end());
    found.erase(std::unique(found.begin(), found.end()), found.end());
    return found;
  });
}

std::optional<Narrowest> Cuts::narrowest(const PeriodicBox& periodic) const {
  if (!Near{0, Norm::max, periodic}.check(dims())) return std::nullopt;
  const auto kept = data_->reach({0, Norm::max, periodic});
  const Reach& reach = *kept;
  std::optional<Narrowest> found;
  for (int part = 0; part < parts(); ++part)
    for (int axis = 0; axis < dims(); ++axis) {
      const Box& region = reach.region(part);
      const double width = region.hi[at(axis)] - region.lo[at(axis)];
      if (width >= 0 && std::isfinite(width) && (!found || width < found->width)) found = {part, axis, width};
    }
  return found;
}

}  // namespace rcb::cuts
