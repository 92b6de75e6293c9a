#include "common/cuts/cuts.hpp"

#include <algorithm>
#include <cmath>
#include <exception>
#include <functional>
#include <mutex>
#include <new>
#include <thread>

#include <fmt/format.h>

#include "common/base/axis_names.hpp"
#include "common/cuts/halo_pass.hpp"

namespace rcb::cuts {
namespace {

using geometry::Box;

constexpr std::size_t kRowsEach = 16384;  // fewer rows than this are not worth a thread
constexpr int kSeatsMax = 1 << 24;

Status bad_call(std::string message) { return {Code::invalid_argument, std::move(message)}; }

Status check_call(const CutTree& tree, const Positions& positions, const OwnerOptions& options) {
  if (positions.dims != tree.dims)
    return bad_call(fmt::format("positions of {} dimensions, the cuts have {}", positions.dims, tree.dims));
  for (std::size_t a = 0; a < at(tree.dims) && positions.count > 0; ++a)
    if ((positions.single() ? static_cast<const void*>(positions.axis_f4[a]) : positions.axis[a]) == nullptr)
      return bad_call(fmt::format("no array for axis {}", kAxisNames[a]));
  if (positions.stride == 0) return bad_call("a stride of 0");
  if (!options.ids.empty() && options.ids.size() != positions.count)
    return bad_call(fmt::format("{} ids for {} positions", options.ids.size(), positions.count));
  if (!options.last_part.empty() && options.last_part.size() != positions.count)
    return bad_call(fmt::format("{} last parts for {} positions", options.last_part.size(), positions.count));
  if (options.threads < 1) return bad_call(fmt::format("{} threads", options.threads));
  return {};
}

// Calls work(k, begin, end) for shares of the rows, each on a thread of its own as far as the system gives them.
// Returns the first share's error.
Status share_rows(std::size_t count, std::size_t shares,
                  const std::function<Status(std::size_t, std::size_t, std::size_t)>& work) {
  std::vector<Status> status(shares);
  const auto run = [&](std::size_t k) {
    try {
      status[k] = work(k, count * k / shares, count * (k + 1) / shares);
    } catch (const std::bad_alloc&) {
      status[k] = Status(Code::too_large, "no memory");  // so short that it needs none
    }
  };
  std::vector<std::thread> threads;
  threads.reserve(shares);
  for (std::size_t k = 1; k < shares; ++k) try {
      threads.emplace_back(run, k);
    } catch (const std::exception&) {  // no thread, or no memory for one
      run(k);
    }
  run(0);
  for (std::thread& thread : threads) thread.join();
  const auto bad = std::find_if(status.begin(), status.end(), [](const Status& one) { return !one.ok(); });
  return bad == status.end() ? Status() : *bad;
}

// What ask() returns, or the error that there was no memory for it.
template <typename Ask>
auto within_memory(const Ask& ask) -> decltype(ask()) {
  try {
    return ask();
  } catch (const std::bad_alloc&) {
    return Status(Code::too_large, "no memory for an answer of the cuts");
  }
}

std::size_t shares_of(std::size_t count, int threads) {
  return std::clamp<std::size_t>(count / kRowsEach, 1, at(threads));
}

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
std::span<const Box> Cuts::regions() const { return data_->tables.boxes; }

Status Cuts::owner(const Positions& positions, const OwnerOptions& options, std::span<std::int32_t> part) const {
  if (Status status = check_call(tree(), positions, options); !status) return status;
  if (part.size() != positions.count)
    return bad_call(fmt::format("room for {} parts of {} positions", part.size(), positions.count));
  return share_rows(positions.count, shares_of(positions.count, options.threads),
                    [&](std::size_t, std::size_t begin, std::size_t end) -> Status {
                      OwnerPass pass(data_->tables, positions, options.ids, options.last_part);
                      for (std::size_t first = begin; first < end; first += Batch::kMost) {
                        const std::size_t count = std::min(Batch::kMost, end - first);
                        if (pass.read_whole(first, count, &part[first])) continue;
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
