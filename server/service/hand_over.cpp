#include "server/service/hand_over.hpp"

#include <algorithm>
#include <cstring>
#include <limits>
#include <numeric>
#include <utility>

#include "common/partition/comm.hpp"
#include "common/plan/plan.hpp"
#include "server/service/collective.hpp"

namespace rcb::service {
namespace {

// Calls apply(scene array, arrivals array) for every array that a particle has.
template <typename Apply>
void for_each_array(Scene& scene, Arrivals& arrivals, const Apply& apply) {
  for (std::size_t a = 0; a < static_cast<std::size_t>(scene.options.dims); ++a)
    apply(scene.particles.position[a], arrivals.particles.position[a]);
  apply(scene.particles.id, arrivals.particles.id);
  if (scene.particles.has_weights) apply(scene.particles.weight, arrivals.particles.weight);
  apply(scene.part, arrivals.part);
}

// Who sends what to whom. The particles that a rank sends are in groups, one a destination, its successor's first, so
// that not all ranks send to the same one at a time.
template <typename Slot>
struct Trip {
  Buffer<Slot> grouped;              // slots of those that leave, group after group
  std::vector<std::uint64_t> begin;  // by destination: where its group begins
  std::vector<std::uint64_t> count;
  std::vector<std::uint64_t> from_count;  // by source
  std::uint64_t arriving = 0;
  // Of rounds alone.
  std::vector<std::uint64_t> from_begin;  // by source: where the group for this rank begins there
  std::uint64_t leaving_max = 0;          // of any rank
};

// Local: what is known here.
template <typename Slot>
Trip<Slot> plan_trip(const partition::Comm& comm, const Scene& scene, const Leavers& leavers,
                     std::span<const std::uint64_t> from) {
  const auto ranks = static_cast<std::size_t>(comm.size());
  const auto rank = static_cast<std::size_t>(comm.rank());
  Trip<Slot> trip;
  trip.count = leavers.counts;
  trip.begin.resize(ranks);
  std::uint64_t at = 0;
  for (std::size_t k = 1; k <= ranks; ++k) {
    const std::size_t r = (rank + k) % ranks;
    trip.begin[r] = std::exchange(at, at + trip.count[r]);
  }
  trip.grouped.resize(leavers.slots.size());
  std::vector<std::uint64_t> next = trip.begin;
  for (const std::uint64_t slot : leavers.slots) {
    const int r = plan::rank_of_part(scene.part[slot], scene.options.parts, comm.size());
    trip.grouped[next[static_cast<std::size_t>(r)]++] = static_cast<Slot>(slot);
  }
  trip.from_count.assign(from.begin(), from.end());
  trip.arriving = std::accumulate(from.begin(), from.end(), std::uint64_t{0});
  return trip;
}

// What rounds need beside. Collective.
template <typename Slot>
void agree_on_rounds(partition::Comm& comm, Trip<Slot>& trip) {
  trip.from_begin.resize(trip.begin.size());
  partition::exchange_counts(comm, trip.begin, trip.from_begin);
  trip.leaving_max = trip.grouped.size();
  comm.all_max({&trip.leaving_max, 1});
}

struct Window {
  std::uint64_t first;
  std::uint64_t last;

  // What of a group lies in this window.
  Window of(std::uint64_t begin, std::uint64_t count) const {
    const std::uint64_t lo = std::max(first, begin);
    return {lo, std::max(lo, std::min(last, begin + count))};
  }
  std::uint64_t size() const { return last - first; }
};

// One column's leavers to the ranks that own them, in rounds, and straight to where they belong: `to` [trip.arriving],
// in the order of the ranks that they come from. Collective.
template <typename T, typename Slot>
void exchange_column(partition::Comm& comm, const Trip<Slot>& trip, const T* from, T* to, std::uint64_t round_bytes) {
  const std::size_t ranks = trip.count.size();
  const std::uint64_t each = std::max<std::uint64_t>(1, round_bytes / sizeof(T));
  const std::uint64_t leaving = trip.grouped.size();
  Buffer<T> packed(std::min(each, leaving));
  std::vector<std::span<const std::byte>> send(ranks);
  std::vector<std::span<std::byte>> receive(ranks);
  for (Window round{0, each}; round.first < trip.leaving_max; round.first += each, round.last += each) {
    for (std::uint64_t k = round.first; k < std::min(round.last, leaving); ++k)
      packed[k - round.first] = from[trip.grouped[k]];
    T* place = to;
    for (std::size_t r = 0; r < ranks; ++r) {
      const Window out = round.of(trip.begin[r], trip.count[r]);
      send[r] = {};
      if (out.size() > 0) send[r] = std::as_bytes(packed.span().subspan(out.first - round.first, out.size()));
      const Window in = round.of(trip.from_begin[r], trip.from_count[r]);
      receive[r] = {};
      if (in.size() > 0)
        receive[r] = std::as_writable_bytes(std::span(place + (in.first - trip.from_begin[r]), in.size()));
      place += trip.from_count[r];
    }
    comm.exchange(send, receive);
  }
}

// An array to leave from and the one to arrive in.
struct Column {
  const std::byte* from;
  std::byte* to;
  std::size_t width;  // bytes of an element
};

// All columns in one exchange, for each destination column after column. Collective.
void exchange_at_once(partition::Comm& comm, const Trip<std::uint64_t>& trip, std::span<const Column> columns) {
  std::size_t width = 0;
  for (const Column& column : columns) width += column.width;
  Buffer<std::byte> packed(trip.grouped.size() * width);
  Buffer<std::byte> arrived(trip.arriving * width);
  std::vector<std::span<const std::byte>> send;
  std::vector<std::span<std::byte>> receive;
  std::byte* to = packed.data();
  std::byte* at = arrived.data();
  for (std::size_t r = 0; r < trip.count.size(); ++r) {
    send.emplace_back(to, trip.count[r] * width);
    receive.emplace_back(at, trip.from_count[r] * width);
    at += trip.from_count[r] * width;
    const std::uint64_t* slots = trip.grouped.data() + trip.begin[r];
    for (const Column& column : columns)
      for (std::uint64_t k = 0; k < trip.count[r]; ++k, to += column.width)
        std::memcpy(to, column.from + slots[k] * column.width, column.width);
  }
  comm.exchange(send, receive);
  std::uint64_t before = 0;
  for (std::size_t r = 0; r < trip.count.size(); ++r) {
    const std::byte* from = receive[r].data();
    for (const Column& column : columns) {
      const std::size_t bytes = trip.from_count[r] * column.width;
      if (bytes > 0) std::memcpy(column.to + before * column.width, from, bytes);
      from += bytes;
    }
    before += trip.from_count[r];
  }
}

// Collective. Few are exchanged all columns at once, since each exchange has its price in waiting; many column by
// column, since that takes less memory.
Arrivals receive_apart(partition::Comm& comm, Scene& scene, const Leavers& leavers, std::span<const std::uint64_t> from,
                       bool few, const HandOverLimits& limits) {
  auto trip = plan_trip<std::uint64_t>(comm, scene, leavers, from);
  Arrivals arrivals;
  arrivals.particles.dims = scene.options.dims;
  arrivals.particles.has_weights = scene.particles.has_weights;
  arrivals.particles.resize(trip.arriving);
  arrivals.part.resize(trip.arriving);
  if (few) {
    std::vector<Column> columns;
    for_each_array(scene, arrivals, [&columns](auto& mine, auto& theirs) {
      columns.push_back(
          {std::as_bytes(mine.span()).data(), std::as_writable_bytes(theirs.span()).data(), sizeof(mine[0])});
    });
    exchange_at_once(comm, trip, columns);
  } else {
    agree_on_rounds(comm, trip);
    for_each_array(scene, arrivals, [&](const auto& mine, auto& theirs) {
      exchange_column(comm, trip, mine.data(), theirs.data(), limits.round_bytes);
    });
  }
  return arrivals;
}

// Puts an array into an order, by way of `spare`, which is left with as much of the memory that the array had as the
// next one needs.
template <typename T, typename Slot>
void put_in_order(Buffer<T>& values, const Buffer<Slot>& order, Buffer<std::byte>& spare) {
  Buffer<T> sorted = spare.release_as<T>();
  sorted.resize(order.size());
  for (std::size_t k = 0; k < order.size(); ++k) sorted[k] = values[order[k]];
  spare = values.template release_as<std::byte>();
  spare.resize(std::min(spare.size(), order.size() * sizeof(double)));
  spare.shrink();
  values = std::move(sorted);
  values.shrink();
}

void sort_by_id(Arrivals& arrivals) {
  const Buffer<particles::Id>& ids = arrivals.particles.id;
  if (std::is_sorted(ids.begin(), ids.end())) return;
  const Buffer<std::uint64_t> order = order_by_id(ids);
  Buffer<std::byte> spare;
  for (std::size_t a = 0; a < static_cast<std::size_t>(arrivals.particles.dims); ++a)
    put_in_order(arrivals.particles.position[a], order, spare);
  put_in_order(arrivals.particles.id, order, spare);
  if (arrivals.particles.has_weights) put_in_order(arrivals.particles.weight, order, spare);
  put_in_order(arrivals.part, order, spare);
}

// A full change: stayers and arrivals together in ascending id. Each array in its turn takes in its arrivals at its
// end, and is put in order. Collective.
template <typename Slot>
void change_all(partition::Comm& comm, Scene& scene, Leavers leavers, std::span<const std::uint64_t> from,
                const HandOverLimits& limits) {
  auto trip = plan_trip<Slot>(comm, scene, leavers, from);
  agree_on_rounds(comm, trip);
  const std::size_t before = scene.part.size();
  Buffer<Slot> order(before - leavers.slots.size() + trip.arriving);
  std::size_t placed = 0;
  auto leaver = leavers.slots.begin();
  for (std::uint64_t slot = 0; slot < before + trip.arriving; ++slot) {
    if (leaver != leavers.slots.end() && *leaver == slot)
      ++leaver;
    else
      order[placed++] = static_cast<Slot>(slot);
  }
  leavers = {};
  const auto take_in = [&](auto& values) {
    values.resize(before + trip.arriving);
    exchange_column(comm, trip, std::as_const(values).data(), values.data() + before, limits.round_bytes);
  };
  take_in(scene.particles.id);
  sort_slots_by_id(order, scene.particles.id.span());
  const bool in_order = order.size() == before + trip.arriving && std::is_sorted(order.begin(), order.end());
  Buffer<std::byte> spare;
  const auto arrange = [&](auto& values) {
    if (!in_order) put_in_order(values, order, spare);
  };
  arrange(scene.particles.id);
  const auto change = [&](auto& values) {
    take_in(values);
    arrange(values);
  };
  for (std::size_t a = 0; a < static_cast<std::size_t>(scene.options.dims); ++a) change(scene.particles.position[a]);
  if (scene.particles.has_weights) change(scene.particles.weight);
  change(scene.part);
}

// The index of ids, where there is one, follows an edit that raises the plan's version by one.
void keep_index(Scene& scene, const plan::RankEdit& edit, const Leavers& leavers, const Arrivals& arrivals) {
  IdIndex& index = scene.index;
  if (index.plan_version != scene.plan_version) return;
  for (const std::uint64_t slot : leavers.slots) index.slot.erase(scene.particles.id[slot]);
  for (const plan::SlotMove& move : edit.moves)
    index.slot[move.arrival ? arrivals.particles.id[move.from] : scene.particles.id[move.from]] = move.to;
  index.plan_version = scene.plan_version + 1;
}

}  // namespace

void count_by_rank(const partition::Comm& comm, const Scene& scene, Leavers& leavers) {
  leavers.counts.assign(static_cast<std::size_t>(comm.size()), 0);
  for (const std::uint64_t slot : leavers.slots)
    ++leavers.counts[static_cast<std::size_t>(plan::rank_of_part(scene.part[slot], scene.options.parts, comm.size()))];
}

std::uint64_t fill_holes(Scene& scene, int rank, const Leavers& leavers, Arrivals& arrivals,
                         const plan::RankEdit& edit) {
  keep_index(scene, edit, leavers, arrivals);
  const std::uint64_t gain = plan::checksum_change(edit, rank, scene.particles.id.span(), leavers.slots,
                                                   std::as_const(arrivals.particles.id).span());
  for_each_array(scene, arrivals,
                 [&edit](auto& mine, auto& theirs) { plan::apply_edit(edit, mine, std::as_const(theirs).span()); });
  return gain;
}

void hand_over(partition::Comm& comm, Scene& scene, Leavers leavers, std::span<const std::uint64_t> from,
               std::uint64_t changed, bool full, const HandOverLimits& limits) {
  std::uint64_t checksum = 0;
  if (full) {
    const std::uint64_t slots = std::accumulate(from.begin(), from.end(), std::uint64_t{scene.part.size()});
    if (slots <= limits.narrow_slots)
      change_all<std::uint32_t>(comm, scene, std::move(leavers), from, limits);
    else
      change_all<std::uint64_t>(comm, scene, std::move(leavers), from, limits);
    checksum = plan::checksum_of_rank(comm.rank(), scene.particles.id.span());
  } else {
    Arrivals arrivals = receive_apart(comm, scene, leavers, from, changed <= limits.few, limits);
    sort_by_id(arrivals);
    checksum = fill_holes(scene, comm.rank(), leavers, arrivals,
                          plan::edit_of_rank(scene.part.size(), leavers.slots, arrivals.part.size()));
  }
  comm.all_sum({&checksum, 1});
  scene.plan_checksum = full ? checksum : scene.plan_checksum + checksum;
  ++scene.plan_version;
}

}  // namespace rcb::service
