#include "server/service/step/exchange.hpp"

#include <algorithm>
#include <cstring>
#include <numeric>
#include <utility>

#include "common/comm/comm.hpp"
#include "common/layout/layout.hpp"
#include "server/service/context/collective.hpp"

namespace rcb::service {
namespace {

// The local particles whose part another rank owns.
struct Exports {
  std::vector<std::uint64_t> counts;  // by destination rank
  std::vector<std::uint64_t> slots;   // ascending
};

struct Arrivals {
  particles::ParticleSet particles;
  Buffer<std::int32_t> part;
};

// Calls apply(scene's array, arrivals' array) for every array of particle data.
template <typename Apply>
void for_each_array(Scene& scene, Arrivals& arrivals, const Apply& apply) {
  for (std::size_t a = 0; a < static_cast<std::size_t>(scene.options.dims); ++a)
    apply(scene.particles.position[a], arrivals.particles.position[a]);
  apply(scene.particles.id, arrivals.particles.id);
  if (scene.particles.has_weights) apply(scene.particles.weight, arrivals.particles.weight);
  apply(scene.part, arrivals.part);
}

// Who sends which particles to whom. A rank's exports are grouped by destination, beginning with the next higher rank,
// so that not all ranks send to the same one at the same time.
struct Exchange {
  Buffer<std::uint64_t> grouped;     // slots of the exports, group after group
  std::vector<std::uint64_t> begin;  // by destination: start of its group
  std::vector<std::uint64_t> count;
  std::vector<std::uint64_t> from_count;  // by source
  std::uint64_t arriving = 0;
  // Only for an exchange in rounds:
  std::vector<std::uint64_t> begin_at_source;  // by source: start of the group for this rank there
  std::uint64_t leaving_max = 0;               // most exports of any rank
};

// Fills in what needs no communication. Local.
Exchange plan_exchange(const comm::Comm& comm, const Scene& scene, const Exports& exports,
                       std::span<const std::uint64_t> from) {
  const auto ranks = static_cast<std::size_t>(comm.size());
  const auto rank = static_cast<std::size_t>(comm.rank());
  Exchange exchange;
  exchange.count = exports.counts;
  exchange.begin.resize(ranks);
  std::uint64_t at = 0;
  for (std::size_t k = 1; k <= ranks; ++k) {
    const std::size_t r = (rank + k) % ranks;
    exchange.begin[r] = std::exchange(at, at + exchange.count[r]);
  }
  exchange.grouped.resize(exports.slots.size());
  std::vector<std::uint64_t> next = exchange.begin;
  for (const std::uint64_t slot : exports.slots) {
    const int r = layout::rank_of_part(scene.part[slot], scene.options.parts, comm.size());
    exchange.grouped[next[static_cast<std::size_t>(r)]++] = slot;
  }
  exchange.from_count.assign(from.begin(), from.end());
  exchange.arriving = std::accumulate(from.begin(), from.end(), std::uint64_t{0});
  return exchange;
}

// Fills in what an exchange in rounds needs. Collective.
void agree_on_rounds(comm::Comm& comm, Exchange& exchange) {
  exchange.begin_at_source.resize(exchange.begin.size());
  comm::exchange_counts(comm, exchange.begin, exchange.begin_at_source);
  exchange.leaving_max = exchange.grouped.size();
  comm.all_max({&exchange.leaving_max, 1});
}

struct Window {
  std::uint64_t first;
  std::uint64_t last;

  // The part of a group that lies in this window.
  Window of(std::uint64_t begin, std::uint64_t count) const {
    const std::uint64_t lo = std::max(first, begin);
    return {lo, std::max(lo, std::min(last, begin + count))};
  }
  std::uint64_t size() const { return last - first; }
};

// Sends the exports of one array to their new ranks, in rounds of at most round_bytes. They are received straight into
// `to` [exchange.arriving], in the order of the sending ranks. Collective.
template <typename T>
void exchange_column(comm::Comm& comm, const Exchange& exchange, const T* from, T* to, std::uint64_t round_bytes) {
  const std::size_t ranks = exchange.count.size();
  const std::uint64_t each = std::max<std::uint64_t>(1, round_bytes / sizeof(T));
  const std::uint64_t leaving = exchange.grouped.size();
  Buffer<T> packed(std::min(each, leaving));
  std::vector<std::span<const std::byte>> send(ranks);
  std::vector<std::span<std::byte>> receive(ranks);
  for (Window round{0, each}; round.first < exchange.leaving_max; round.first += each, round.last += each) {
    for (std::uint64_t k = round.first; k < std::min(round.last, leaving); ++k)
      packed[k - round.first] = from[exchange.grouped[k]];
    T* place = to;
    for (std::size_t r = 0; r < ranks; ++r) {
      const Window out = round.of(exchange.begin[r], exchange.count[r]);
      send[r] = {};
      if (out.size() > 0) send[r] = std::as_bytes(packed.span().subspan(out.first - round.first, out.size()));
      const Window in = round.of(exchange.begin_at_source[r], exchange.from_count[r]);
      receive[r] = {};
      if (in.size() > 0)
        receive[r] = std::as_writable_bytes(std::span(place + (in.first - exchange.begin_at_source[r]), in.size()));
      place += exchange.from_count[r];
    }
    comm.exchange(send, receive);
  }
}

// One array of particle data: the scene's, and the one for its arrivals.
struct Column {
  const std::byte* from;
  std::byte* to;
  std::size_t width;  // bytes per element
};

// Sends all columns in one exchange; a destination's message holds one column after another. Collective.
void exchange_at_once(comm::Comm& comm, const Exchange& exchange, std::span<const Column> columns) {
  std::size_t width = 0;
  for (const Column& column : columns) width += column.width;
  Buffer<std::byte> packed(exchange.grouped.size() * width);
  Buffer<std::byte> arrived(exchange.arriving * width);
  std::vector<std::span<const std::byte>> send;
  std::vector<std::span<std::byte>> receive;
  std::byte* to = packed.data();
  std::byte* at = arrived.data();
  for (std::size_t r = 0; r < exchange.count.size(); ++r) {
    send.emplace_back(to, exchange.count[r] * width);
    receive.emplace_back(at, exchange.from_count[r] * width);
    at += exchange.from_count[r] * width;
    const std::uint64_t* slots = exchange.grouped.data() + exchange.begin[r];
    for (const Column& column : columns)
      for (std::uint64_t k = 0; k < exchange.count[r]; ++k, to += column.width)
        std::memcpy(to, column.from + slots[k] * column.width, column.width);
  }
  comm.exchange(send, receive);
  std::uint64_t before = 0;
  for (std::size_t r = 0; r < exchange.count.size(); ++r) {
    const std::byte* from = receive[r].data();
    for (const Column& column : columns) {
      const std::size_t bytes = exchange.from_count[r] * column.width;
      if (bytes > 0) std::memcpy(column.to + before * column.width, from, bytes);
      from += bytes;
    }
    before += exchange.from_count[r];
  }
}

// Collective. Receives the arrivals into arrays of their own. Few particles travel with all columns in one exchange,
// since each exchange costs a synchronisation; many travel column by column, which takes less memory.
Arrivals receive_apart(comm::Comm& comm, Scene& scene, const Exports& exports, std::span<const std::uint64_t> from,
                       bool few, const ExchangeLimits& limits) {
  auto exchange = plan_exchange(comm, scene, exports, from);
  Arrivals arrivals;
  arrivals.particles.dims = scene.options.dims;
  arrivals.particles.has_weights = scene.particles.has_weights;
  arrivals.particles.resize(exchange.arriving);
  arrivals.part.resize(exchange.arriving);
  if (few) {
    std::vector<Column> columns;
    for_each_array(scene, arrivals, [&columns](auto& mine, auto& theirs) {
      columns.push_back(
          {std::as_bytes(mine.span()).data(), std::as_writable_bytes(theirs.span()).data(), sizeof(mine[0])});
    });
    exchange_at_once(comm, exchange, columns);
  } else {
    agree_on_rounds(comm, exchange);
    for_each_array(scene, arrivals, [&](const auto& mine, auto& theirs) {
      exchange_column(comm, exchange, mine.data(), theirs.data(), limits.round_bytes);
    });
  }
  return arrivals;
}

// A full change: all of a rank's particles, old and new, in ascending id. Array by array, the arrivals are received
// behind the last element and the array is reordered. Collective.
void change_all(comm::Comm& comm, Scene& scene, Exports exports, std::span<const std::uint64_t> from,
                const ExchangeLimits& limits) {
  auto exchange = plan_exchange(comm, scene, exports, from);
  agree_on_rounds(comm, exchange);
  const std::size_t before = scene.part.size();
  Buffer<std::uint64_t> order(before - exports.slots.size() + exchange.arriving);
  std::size_t placed = 0;
  auto exported = exports.slots.begin();
  for (std::uint64_t slot = 0; slot < before + exchange.arriving; ++slot) {
    if (exported != exports.slots.end() && *exported == slot)
      ++exported;
    else
      order[placed++] = slot;
  }
  exports = {};
  const auto take_in = [&](auto& values) {
    values.resize(before + exchange.arriving);
    exchange_column(comm, exchange, std::as_const(values).data(), values.data() + before, limits.round_bytes);
  };
  take_in(scene.particles.id);
  sort_slots_by_id(order, scene.particles.id.span());
  const bool in_order = order.size() == before + exchange.arriving && std::is_sorted(order.begin(), order.end());
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

// What a rank does with its arrays when few particles leave and arrive.
struct SlotMove {
  std::uint64_t to;
  std::uint64_t from;  // number of the arrival, else a slot behind the new end
  bool arrival;
};

// No slot that a particle comes from is one that another goes to, so the order of moves doesn't matter. leaving:
// ascending. Work in proportion to what leaves and arrives.
std::vector<SlotMove> moves_of(std::uint64_t count, std::span<const std::uint64_t> leaving, std::uint64_t arrivals) {
  const std::uint64_t new_count = count - leaving.size() + arrivals;
  std::vector<SlotMove> moves;
  moves.reserve(std::max<std::size_t>(arrivals, leaving.size()));
  const std::uint64_t into_holes = std::min<std::uint64_t>(arrivals, leaving.size());
  for (std::uint64_t i = 0; i < into_holes; ++i) moves.push_back({leaving[i], i, true});
  for (std::uint64_t i = into_holes; i < arrivals; ++i) moves.push_back({count + i - into_holes, i, true});
  // Fewer arrivals than exports: particles in slots behind the new end move into the holes that are left.
  auto gone = std::lower_bound(leaving.begin(), leaving.end(), new_count);
  std::size_t hole = into_holes;
  for (std::uint64_t slot = new_count; slot < count; ++slot) {
    if (gone != leaving.end() && *gone == slot)
      ++gone;
    else
      moves.push_back({leaving[hole++], slot, false});
  }
  return moves;
}

// Arrivals fill free slots, the other particles keep theirs. Local.
void fill_holes(Scene& scene, std::span<const std::uint64_t> leaving, Arrivals& arrivals) {
  const std::size_t count = scene.part.size();
  const std::size_t new_count = count - leaving.size() + arrivals.part.size();
  const std::vector<SlotMove> moves = moves_of(count, leaving, arrivals.part.size());
  for_each_array(scene, arrivals, [&](auto& mine, auto& theirs) {
    mine.resize(std::max(count, new_count));
    for (const SlotMove& move : moves) mine[move.to] = move.arrival ? theirs[move.from] : mine[move.from];
    mine.resize(new_count);
  });
}

// from: by rank, how many particles arrive from it; changed: exports, all ranks together. Collective.
void exchange_particles(comm::Comm& comm, Scene& scene, Exports exports, std::span<const std::uint64_t> from,
                        std::uint64_t changed, bool full, const ExchangeLimits& limits) {
  if (full) return change_all(comm, scene, std::move(exports), from, limits);
  Arrivals arrivals = receive_apart(comm, scene, exports, from, changed <= limits.few, limits);
  fill_holes(scene, exports.slots, arrivals);
}

Exports exports_of(const comm::Comm& comm, const Scene& scene, std::vector<std::uint64_t> slots) {
  Exports exports{std::vector<std::uint64_t>(static_cast<std::size_t>(comm.size()), 0), std::move(slots)};
  for (const std::uint64_t slot : exports.slots)
    ++exports
          .counts[static_cast<std::size_t>(layout::rank_of_part(scene.part[slot], scene.options.parts, comm.size()))];
  return exports;
}

}  // namespace

std::uint64_t send_strangers(comm::Comm& comm, Scene& scene, bool first, const ExchangeLimits& limits) {
  const layout::PartRange own = layout::parts_of_rank(comm.rank(), scene.options.parts, comm.size());
  std::vector<std::uint64_t> slots;
  for (std::size_t i = 0; i < scene.part.size(); ++i)
    if (!own.has(scene.part[i])) slots.push_back(i);
  std::uint64_t changed = slots.size();
  comm.all_sum({&changed, 1});
  if (changed == 0 && !first) return 0;
  Exports exports = exports_of(comm, scene, std::move(slots));
  std::vector<std::uint64_t> from(exports.counts.size());
  if (changed > 0) comm::exchange_counts(comm, exports.counts, from);
  exchange_particles(comm, scene, std::move(exports), from, changed, first || is_full_change(changed, scene.n), limits);
  return changed;
}

void send_exports(comm::Comm& comm, Scene& scene, std::vector<std::uint64_t> slots, std::uint64_t changed,
                  std::span<const std::uint64_t> from_to) {
  Exports exports = exports_of(comm, scene, std::move(slots));
  const auto ranks = static_cast<std::size_t>(comm.size());
  std::vector<std::uint64_t> from(ranks);
  if (from_to.empty())
    comm::exchange_counts(comm, exports.counts, from);
  else
    for (std::size_t r = 0; r < ranks; ++r) from[r] = from_to[r * ranks + static_cast<std::size_t>(comm.rank())];
  exchange_particles(comm, scene, std::move(exports), from, changed, is_full_change(changed, scene.n), {});
}

}  // namespace rcb::service
