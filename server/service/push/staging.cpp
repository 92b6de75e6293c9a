#include "server/service/push/staging.hpp"

#include <algorithm>
#include <numeric>
#include <utility>

#include <fmt/format.h>

#include "common/base/check.hpp"
#include "common/cuts/count.hpp"
#include "common/cuts/id_sum.hpp"
#include "common/layout/layout.hpp"
#include "server/service/context/collective.hpp"
#include "server/service/push/values.hpp"

namespace rcb::service {
namespace {

// Once a step has changed anything it must not lack memory for new cuts or for particles that change rank. So there
// must be room for the most that a rank may get of either before it is known whether it is needed. Local.
Status room_for_step(const comm::Comm& comm, const Scene& scene, const Staged& staged, std::uint64_t mine) {
  const std::uint64_t mean = staged.n / static_cast<std::uint64_t>(comm.size());
  // A search among all particles begins by freeing the memory that the commit swaps out; but until then rows take
  // parts, and those that leave are listed, in a vector that grows.
  constexpr std::uint64_t kBytesOfRow = sizeof(std::int32_t) + 2 * sizeof(std::uint64_t);
  const std::uint64_t freed = scene.particles.count() * static_cast<std::uint64_t>(scene.options.dims) * sizeof(double);
  return room_to_partition(comm, std::max(mine, mean), scene.options.parts,
                           freed - std::min(freed, mine * kBytesOfRow));
}

// Where drift alone brings a rank more than that.
Status agree_room_to_migrate(comm::Comm& comm, std::uint64_t n, const StepSums& sums) {
  constexpr std::uint64_t kFew = 65536;
  if (sums.exported <= std::max(kFew, n / static_cast<std::uint64_t>(comm.size()))) return {};
  const auto ranks = static_cast<std::size_t>(comm.size());
  const auto rank = static_cast<std::size_t>(comm.rank());
  std::uint64_t arriving = sums.from_to.empty() ? sums.exported : 0;
  if (!sums.from_to.empty())
    for (std::size_t r = 0; r < ranks; ++r) arriving += sums.from_to[r * ranks + rank];
  constexpr std::uint64_t kBytesOfParticle = 64;  // its values, and as they arrive
  return agree_room(comm, arriving * kBytesOfParticle, fmt::format("{} particles that change rank", arriving));
}

// Fills in sums.exported and from_to, and adds up all sums. exports: where each goes. Collective.
template <typename RankOf>
void add_up(comm::Comm& comm, const std::vector<std::uint64_t>& exports, RankOf rank_of, StepSums& sums) {
  const auto ranks = static_cast<std::size_t>(comm.size());
  const std::size_t pairs = comm.size() <= StepSums::kRanksMax ? ranks * ranks : 0;
  std::vector<std::uint64_t> cells{sums.faults,    sums.rows,   sums.drifted,
                                   sums.strangers, sums.id_sum, sums.faults > 0 ? 0 : exports.size()};
  const std::size_t fixed = cells.size();
  cells.resize(fixed + pairs);
  if (pairs > 0 && sums.faults == 0)
    for (const std::uint64_t slot : exports)
      ++cells[fixed + static_cast<std::size_t>(comm.rank()) * ranks + static_cast<std::size_t>(rank_of(slot))];
  cells.insert(cells.end(), sums.counts.begin(), sums.counts.end());
  comm.all_sum(cells);
  sums.faults = cells[0], sums.rows = cells[1], sums.drifted = cells[2];
  sums.strangers = cells[3], sums.id_sum = cells[4], sums.exported = cells[5];
  const auto matrix = cells.begin() + static_cast<std::ptrdiff_t>(fixed);
  sums.from_to.assign(matrix, matrix + static_cast<std::ptrdiff_t>(pairs));
  std::copy(matrix + static_cast<std::ptrdiff_t>(pairs), cells.end(), sums.counts.begin());
}

// Whether counts by part are among the sums.
bool sums_counts(const Scene& scene, bool weights) {
  return !weights && scene.epoch > 0 && scene.options.parts <= StepSums::kPartsMax;
}

int seat_of(const std::vector<Run>& runs, std::size_t i) {
  for (const Run& run : runs)
    if (i >= run.begin && i < run.begin + run.count) return run.seat;
  return 0;
}

// The smallest id that several rows have, on all ranks together: duplicate_id, naming the seats that push it. Sets
// `other` to whether ids aren't 0..n-1. Collective.
Status check_distinct(comm::Comm& comm, int seats, const std::vector<Run>& runs, std::span<const particles::Id> ids,
                      std::uint64_t n, bool& other) {
  std::uint64_t greatest = 0;
  for (const particles::Id id : ids) greatest = std::max(greatest, static_cast<std::uint64_t>(id));
  const auto twin = duplicate_id(comm, ids, greatest);
  other = n > 0 && greatest != n - 1;
  if (!twin) return {};
  std::uint64_t least = kNone, most = 0;
  for (std::size_t i = 0; i < ids.size(); ++i) {
    if (ids[i] != *twin) continue;
    least = std::min(least, static_cast<std::uint64_t>(seat_of(runs, i)));
    most = std::max(most, static_cast<std::uint64_t>(seat_of(runs, i)));
  }
  comm.all_min({&least, 1});
  comm.all_max({&most, 1});
  return {Code::duplicate_id,
          seats == 1      ? fmt::format("id {} occurs more than once", *twin)
          : least == most ? fmt::format("seat {} pushes id {} twice", least, *twin)
                          : fmt::format("id {} is pushed by seat {} and by seat {}", *twin, least, most),
          "ids must be distinct"};
}

// Whether the rows must be the particles that the ranks hold.
bool stays_same(const Scene& scene, const PushRequest& push) {
  return scene.epoch > 0 && scene.n > 0 && !push.flows() && !push.counted_ids;
}

// Whether the client says which particle a row is, and so may name one twice.
bool names_rows(const PushRequest& push) {
  return push.ids || std::ranges::any_of(push.blocks, [](const Block& block) {
           return block.way == api::Way::shared_memory && !block.counts.empty();
         });
}

// What the rows must be besides good values. Collective.
Status check_identity(comm::Comm& comm, const Scene& scene, const PushRequest& push, const std::vector<Run>& runs,
                      Staged& staged) {
  if (staged.sums.rows != push.n)
    return {Code::internal, fmt::format("the ranks have read {} rows of {}", staged.sums.rows, push.n)};
  if (staged.same && !names_rows(push)) return {};
  const auto expected = staged.same ? std::optional(scene.key.sum) : push.counted_ids ? push.counted_ids : scene.id_sum;
  if (scene.epoch > 0 && scene.n > 0 && !push.flows() && expected && *expected != staged.sums.id_sum)
    return {Code::not_conserved,
            fmt::format("the ids pushed aren't those of scene '{}': they are other particles, or some are missing and "
                        "others come twice",
                        scene.name),
            "push each particle once, by its id; say how many come ('inserted') and go ('removed')"};
  staged.ids = stays_same(scene, push) && scene.ids;
  if (staged.same || !names_rows(push)) return {};
  return check_distinct(comm, push.seats, runs, staged.arrays.id.span(), push.n, staged.ids);
}

// The parts of this rank's rows under the cuts in force, and what follows from them. Local. Errors: too_large; others
// where a value is at fault.
Status find_parts(const comm::Comm& comm, Scene& scene, const PushRequest& push, const std::vector<Run>& runs,
                  Staged& staged) {
  const particles::ParticleView view = staged.arrays.view();
  const auto dims = static_cast<std::size_t>(view.dims);
  // Rows often come in the same order again, so the parts held are a good hint.
  staged.part.assign(scene.part.span().first(std::min(scene.part.size(), view.count)));
  const std::size_t hinted = staged.part.size();
  staged.part.resize(view.count);
  if (hinted > 0) std::fill(staged.part.begin() + hinted, staged.part.end(), staged.part[hinted - 1]);
  cuts::CountOptions options;
  options.ids = staged.arrays.id.span();
  if (!staged.same || names_rows(push)) options.id_key = staged.same ? *scene.key.key : 0;
  if (hinted > 0) options.last_part = staged.part.span();
  if (push.weights) options.weights = staged.arrays.weight.span();
  const auto positions = cuts::Positions::axes(std::span(view.position.data(), dims), view.count);
  auto counted = cuts::count(scene.snapshot(), positions, options, staged.part.span());
  if (!counted.ok()) return counted.status();
  staged.sums.id_sum = counted->id_sum;
  const layout::PartRange own = layout::parts_of_rank(comm.rank(), scene.options.parts, comm.size());
  const auto first_own = counted->counts.begin() + own.begin;
  if (std::accumulate(first_own, first_own + (own.end - own.begin), std::uint64_t{0}) < view.count)
    for (std::size_t i = 0; i < view.count; ++i)
      if (!own.has(staged.part[i])) staged.exports.push_back(i);
  if (!staged.sums.counts.empty()) staged.sums.counts = std::move(counted->counts);
  if (push.seats > 1)
    for (const Run& run : runs) {
      const layout::PartRange parts = layout::parts_of_rank(run.seat, scene.options.parts, push.seats);
      for (std::size_t i = run.begin; i < run.begin + run.count; ++i)
        staged.sums.strangers += parts.has(staged.part[i]) ? 0U : 1U;
    }
  return {};
}

// Collective.
Status check_set(comm::Comm& comm, Scene& scene, const PushRequest& push, const std::vector<Run>& runs,
                 Staged& staged) {
  staged.same = stays_same(scene, push) && scene.key.key;
  const std::uint64_t mine = staged.arrays.count();
  Status ready = room_for_step(comm, scene, staged, mine);
  StepSums& sums = staged.sums;
  sums.rows = mine;
  if (sums_counts(scene, push.weights)) sums.counts.resize(static_cast<std::size_t>(scene.options.parts));
  bool fault = false;  // a value is wrong
  if (ready.ok() && scene.epoch == 0) {
    fault = has_fault(staged.arrays.view());
    sums.id_sum = cuts::sum_ids(staged.arrays.id.span(), 0).any_order;
  } else if (ready.ok()) {
    Status found = find_parts(comm, scene, push, runs, staged);
    fault = !found.ok() && found.code() != Code::too_large;
    if (!fault) ready = std::move(found);
  }
  sums.faults = ready.ok() && !fault ? 0 : 1;
  const auto rank_of = [&](std::uint64_t slot) {
    return layout::rank_of_part(staged.part[slot], scene.options.parts, comm.size());
  };
  add_up(comm, staged.exports, rank_of, sums);
  if (sums.faults > 0) {
    if (Status status = agree_status(comm, ready); !status.ok()) return status;
    return fault_in(comm, staged.arrays.view(), push.ids);
  }
  if (Status status = check_identity(comm, scene, push, runs, staged); !status.ok()) return status;
  return agree_room_to_migrate(comm, staged.n, sums);
}

// Opens the shared memory of the held particles' rows, with room for what is read from it. Local.
Result<SharedSource> open_source(const Context& context, Scene& scene, const PushRequest& push, Staged& staged) {
  if (context.slices.size() != 1)
    return Status(Code::aborted, fmt::format("rank {} has no slice of the push", context.comm.rank()),
                  "push the step again");
  const std::uint64_t mine = scene.particles.count();
  for (std::size_t a = 0; a < static_cast<std::size_t>(scene.options.dims); ++a)
    staged.arrays.position[a] = context.options.spare->take(scene.name).release_as<double>();
  bool fits = !push.weights || staged.arrays.weight.try_reserve(mine);
  for (std::size_t a = 0; a < static_cast<std::size_t>(scene.options.dims); ++a)
    fits = fits && staged.arrays.position[a].try_reserve(mine);
  if (!fits)
    return Status(Code::too_large, fmt::format("rank {} has no memory for {} particles", context.comm.rank(), mine));
  for (std::size_t a = 0; a < static_cast<std::size_t>(scene.options.dims); ++a) staged.arrays.position[a].resize(mine);
  if (push.weights) staged.arrays.weight.resize(mine);
  return SharedSource::open(context.slices.front(), scene.options.dims);
}

// Collective: one reduction.
Status prepare_held(Context& context, Scene& scene, const PushRequest& push, Staged& staged) {
  comm::Comm& comm = context.comm;
  Status ready = room_for_step(comm, scene, staged, scene.particles.count());
  if (ready.ok()) {
    const auto source = open_source(context, scene, push, staged);
    ready = source.status();
    if (ready.ok() && push.weights) source->weights(scene.particles.id.span(), staged.arrays.weight.data());
    if (ready.ok()) staged.scan = scan_shared(scene, *source, staged.arrays, comm.rank(), comm.size());
  }
  context.slices.clear();
  StepSums& sums = staged.sums;
  const Drift& drift = staged.scan.drift;
  sums.faults = ready.ok() && !staged.scan.fault ? 0 : 1;
  sums.rows = scene.particles.count();
  sums.drifted = drift.count();
  if (sums_counts(scene, scene.particles.has_weights))
    sums.counts = count_changes(scene, drift);  // of use only without faults
  const layout::PartRange own = layout::parts_of_rank(comm.rank(), scene.options.parts, comm.size());
  std::vector<int> to;
  for (std::size_t k = 0; k < drift.count() && sums.faults == 0; ++k) {
    if (own.has(drift.part[k])) continue;
    staged.exports.push_back(drift.slot[k]);
    to.push_back(layout::rank_of_part(drift.part[k], scene.options.parts, comm.size()));
  }
  add_up(
      comm, staged.exports, [next = to.begin()](std::uint64_t) mutable { return *next++; }, sums);
  if (sums.faults == 0) return agree_room_to_migrate(comm, scene.n, sums);
  if (Status status = agree_status(comm, ready); !status.ok()) return status;
  particles::ParticleView view = staged.arrays.view();
  view.count = scene.particles.count();
  view.id = scene.particles.id.data();
  return fault_in(comm, view, push.ids);
}

// Bytes of all arrays as received.
std::uint64_t bytes_of(const Scene& scene, const PushRequest& push) {
  std::uint64_t bytes = push.n * ((push.weights ? 8U : 0U) + (push.ids ? 8U : 0U));
  for (const Block& block : push.blocks)
    bytes += block.n * static_cast<std::uint64_t>(scene.options.dims) * (block.is_float32 ? 4U : 8U);
  return bytes;
}

}  // namespace

void give_back(Context& context, const Scene& scene, Staged& staged, api::Way way) {
  if (!staged.took_slice && way != api::Way::shared_memory) return;
  std::vector<Buffer<std::byte>> buffers;
  for (std::size_t a = 0; a < static_cast<std::size_t>(scene.options.dims); ++a)
    buffers.push_back(staged.arrays.position[a].release_as<std::byte>());
  if (staged.arrays.weight.capacity() > 0) buffers.push_back(staged.arrays.weight.release_as<std::byte>());
  if (staged.arrays.id.capacity() > 0) buffers.push_back(staged.arrays.id.release_as<std::byte>());
  context.options.spare->keep(scene.name, std::move(buffers));
}

Result<Staged> prepare_set(comm::Comm& comm, Scene& scene, const PushRequest& push, Arrived arrived) {
  Staged staged{.n = push.n, .arrays = std::move(arrived.set), .took_slice = arrived.took_slice};
  if (Status status = check_set(comm, scene, push, arrived.runs, staged); !status.ok()) return status;
  return staged;
}

Result<Staged> prepare(Context& context, Scene& scene, const PushRequest& push) {
  const double start = context.clock.seconds();
  RCB_CHECK(!stays_same(scene, push) || push.n == scene.n, "the ledger counts the particles before it orders a push");
  Staged staged{.n = push.n, .ids = scene.ids, .held = push.of_held(scene)};
  if (staged.held) {
    staged.arrays.dims = scene.options.dims;
    staged.arrays.has_weights = push.weights;
    if (Status status = prepare_held(context, scene, push, staged); !status.ok()) return status;
  } else {
    auto arrived = read_blocks(context, scene, push);
    if (!arrived.ok()) return arrived.status();
    auto set = prepare_set(context.comm, scene, push, std::move(*arrived));
    if (!set.ok()) return set;
    staged = std::move(*set);
  }
  staged.bytes = bytes_of(scene, push);
  staged.seconds = context.terms.received_seconds + context.clock.seconds() - start;
  return staged;
}

}  // namespace rcb::service
