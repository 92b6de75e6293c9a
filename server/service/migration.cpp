#include "server/service/migration.hpp"

#include <algorithm>
#include <array>
#include <numeric>
#include <type_traits>
#include <utility>

#include "common/partition/comm.hpp"
#include "common/plan/plan.hpp"
#include "server/service/collective.hpp"

namespace rcb::service {
namespace {

// The local particles that leave, grouped by destination, each group in ascending slot order.
struct Leavers {
  std::vector<std::uint64_t> counts;  // by rank
  std::vector<std::uint64_t> slots;   // ascending
  Buffer<std::uint64_t> grouped;      // slots, group after group
};

Leavers find_leavers(const partition::Comm& comm, const Scene& scene) {
  const int ranks = comm.size();
  const std::int64_t mine_begin = plan::part_begin(comm.rank(), scene.options.parts, ranks);
  const std::int64_t mine_end = plan::part_begin(comm.rank() + 1, scene.options.parts, ranks);
  Leavers leavers;
  leavers.counts.assign(static_cast<std::size_t>(ranks), 0);
  for (std::size_t i = 0; i < scene.part.size(); ++i)
    if (scene.part[i] < mine_begin || scene.part[i] >= mine_end) leavers.slots.push_back(i);
  std::vector<std::size_t> to(leavers.slots.size());
  for (std::size_t k = 0; k < to.size(); ++k) {
    to[k] = static_cast<std::size_t>(plan::rank_of_part(scene.part[leavers.slots[k]], scene.options.parts, ranks));
    ++leavers.counts[to[k]];
  }
  std::vector<std::uint64_t> at(static_cast<std::size_t>(ranks), 0);
  std::exclusive_scan(leavers.counts.begin(), leavers.counts.end(), at.begin(), std::uint64_t{0});
  leavers.grouped.resize(leavers.slots.size());
  for (std::size_t k = 0; k < to.size(); ++k) leavers.grouped[at[to[k]]++] = leavers.slots[k];
  return leavers;
}

struct Arrivals {
  particles::ParticleSet particles;
  Buffer<std::int32_t> part;
};

// One array's leavers to their ranks. Collective.
template <typename T>
void exchange_array(partition::Comm& comm, const Leavers& leavers, std::span<const std::uint64_t> from_counts,
                    const Buffer<T>& values, Buffer<T>& arrived) {
  Buffer<T> packed(leavers.grouped.size());
  for (std::size_t k = 0; k < packed.size(); ++k) packed[k] = values[leavers.grouped[k]];
  std::vector<std::span<const std::byte>> send;
  std::vector<std::span<std::byte>> receive;
  std::uint64_t sent = 0;
  std::uint64_t received = 0;
  for (std::size_t r = 0; r < from_counts.size(); ++r) {
    send.push_back(std::as_bytes(packed.span().subspan(sent, leavers.counts[r])));
    receive.push_back(std::as_writable_bytes(arrived.span().subspan(received, from_counts[r])));
    sent += leavers.counts[r];
    received += from_counts[r];
  }
  comm.exchange(send, receive);
}

Arrivals exchange_leavers(partition::Comm& comm, const Scene& scene, const Leavers& leavers) {
  std::vector<std::uint64_t> from(leavers.counts.size());
  partition::exchange_counts(comm, leavers.counts, from);
  Arrivals arrivals;
  arrivals.particles.dims = scene.options.dims;
  arrivals.particles.has_weights = scene.particles.has_weights;
  const std::uint64_t count = std::accumulate(from.begin(), from.end(), std::uint64_t{0});
  arrivals.particles.resize(count);
  arrivals.part.resize(count);
  for (std::size_t a = 0; a < static_cast<std::size_t>(scene.options.dims); ++a)
    exchange_array(comm, leavers, from, scene.particles.position[a], arrivals.particles.position[a]);
  exchange_array(comm, leavers, from, scene.particles.id, arrivals.particles.id);
  if (scene.particles.has_weights)
    exchange_array(comm, leavers, from, scene.particles.weight, arrivals.particles.weight);
  exchange_array(comm, leavers, from, scene.part, arrivals.part);
  return arrivals;
}

// Calls apply(scene array, arrivals array) for every array that a particle has.
template <typename Apply>
void for_each_array(Scene& scene, Arrivals& arrivals, const Apply& apply) {
  for (std::size_t a = 0; a < static_cast<std::size_t>(scene.options.dims); ++a)
    apply(scene.particles.position[a], arrivals.particles.position[a]);
  apply(scene.particles.id, arrivals.particles.id);
  if (scene.particles.has_weights) apply(scene.particles.weight, arrivals.particles.weight);
  apply(scene.part, arrivals.part);
}

// Puts particles into ascending id.
void sort_by_id(particles::ParticleSet& particles, Buffer<std::int32_t>& part) {
  if (std::is_sorted(particles.id.begin(), particles.id.end())) return;
  const Buffer<std::uint64_t> order = order_by_id(particles.id);
  const auto permute = [&order](auto& values) {
    std::remove_reference_t<decltype(values)> sorted(values.size());
    for (std::size_t k = 0; k < order.size(); ++k) sorted[k] = values[order[k]];
    values.swap(sorted);
  };
  for (std::size_t a = 0; a < static_cast<std::size_t>(particles.dims); ++a) permute(particles.position[a]);
  if (particles.has_weights) permute(particles.weight);
  permute(part);
  permute(particles.id);  // last: the others are sorted by it
}

// A full change: stayers and arrivals together in ascending id.
void rebuild(Scene& scene, const Leavers& leavers, Arrivals& arrivals) {
  Buffer<std::uint64_t> stayers(scene.part.size() - leavers.slots.size());
  std::size_t kept = 0;
  std::size_t next = 0;
  for (std::uint64_t i = 0; i < scene.part.size(); ++i) {
    if (next < leavers.slots.size() && leavers.slots[next] == i) {
      ++next;
    } else {
      stayers[kept++] = i;
    }
  }
  for_each_array(scene, arrivals, [&](auto& mine, auto& theirs) {
    for (std::size_t k = 0; k < stayers.size(); ++k) mine[k] = mine[stayers[k]];
    mine.resize(stayers.size());
    mine.append(theirs.span());
    theirs.release();
  });
  sort_by_id(scene.particles, scene.part);
}

// A small change: free slots are filled, the rest stays where it is. Returns what the plan's checksum gains.
std::uint64_t fill_holes(Scene& scene, int rank, const Leavers& leavers, Arrivals& arrivals) {
  sort_by_id(arrivals.particles, arrivals.part);
  const plan::RankEdit edit = plan::edit_of_rank(scene.part.size(), leavers.slots, arrivals.part.size());
  const std::uint64_t gain = plan::checksum_change(edit, rank, scene.particles.id.span(), leavers.slots,
                                                   std::as_const(arrivals.particles.id).span());
  for_each_array(scene, arrivals,
                 [&edit](auto& mine, auto& theirs) { plan::apply_edit(edit, mine, std::as_const(theirs).span()); });
  return gain;
}

}  // namespace

std::uint64_t migrate(partition::Comm& comm, Scene& scene, bool first) {
  const Leavers leavers = find_leavers(comm, scene);
  std::uint64_t changed = leavers.slots.size();
  comm.all_sum({&changed, 1});
  if (changed == 0 && !first) return 0;
  Arrivals arrivals;
  if (changed > 0) {
    arrivals = exchange_leavers(comm, scene, leavers);
  } else {
    arrivals.particles.dims = scene.options.dims;
    arrivals.particles.has_weights = scene.particles.has_weights;
  }
  const bool full = first || plan::is_full_change(changed, scene.n);
  std::uint64_t checksum = 0;
  if (full) {
    rebuild(scene, leavers, arrivals);
    checksum = plan::checksum_of_rank(comm.rank(), scene.particles.id.span());
  } else {
    checksum = fill_holes(scene, comm.rank(), leavers, arrivals);
  }
  comm.all_sum({&checksum, 1});
  scene.plan_checksum = full ? checksum : scene.plan_checksum + checksum;
  ++scene.plan_version;
  return changed;
}

}  // namespace rcb::service
