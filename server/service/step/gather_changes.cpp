#include "server/service/step/gather_changes.hpp"

#include <algorithm>
#include <cstring>
#include <limits>

#include "server/service/context/collective.hpp"

namespace rcb::service {
namespace {

constexpr std::size_t kBytesPerChange = sizeof(particles::Id) + sizeof(std::int32_t);

void sort_by_id(PartChanges& changes) {
  if (std::is_sorted(changes.id.begin(), changes.id.end())) return;
  const Buffer<std::uint64_t> order = order_by_id(changes.id);
  Buffer<std::byte> spare;
  put_in_order(changes.id, order, spare);
  put_in_order(changes.part, order, spare);
}

// Divides the ids into windows with at most `at_once` changes each, all ranks together; returns the last id of each
// window but the last. Each rank shows every `apart`-th of its ids, and a window ends at every `chosen`-th id shown. So
// it has at most chosen * apart ids, and fewer than `apart` more from each rank. Collective.
std::vector<particles::Id> window_ends(comm::Comm& comm, const Buffer<particles::Id>& ids, std::uint64_t most,
                                       std::uint64_t at_once) {
  if (most <= at_once) return {};
  const auto chosen = static_cast<std::size_t>(std::max(8, comm.size()));
  const std::size_t apart = std::max<std::size_t>(1, at_once / (2 * chosen));
  Buffer<particles::Id> shown;
  for (std::size_t k = apart; k <= ids.size(); k += apart) shown.push_back(ids[k - 1]);
  auto all = comm::all_gather_values<particles::Id>(comm, std::as_const(shown).span()).values;
  std::sort(all.begin(), all.end());
  std::vector<particles::Id> ends;
  for (std::size_t k = chosen; k <= all.size(); k += chosen) ends.push_back(all[k - 1]);
  return ends;
}

// Merges the ranks' ascending runs of changes into one, with a heap of the runs.
void merge_runs(const Buffer<std::byte>& bytes, const std::vector<std::size_t>& sizes, PartChanges& all) {
  struct Run {
    particles::Id id;
    const std::byte* ids;
    const std::byte* parts;
    std::size_t left;
  };
  std::vector<Run> heap;
  const auto later = [](const Run& a, const Run& b) { return a.id > b.id; };
  const auto read = [](Run& run) { std::memcpy(&run.id, run.ids, sizeof run.id); };
  std::size_t at = 0;
  for (const std::size_t size : sizes) {
    const std::size_t count = size / kBytesPerChange;
    if (count > 0) {
      heap.push_back({0, bytes.data() + at, bytes.data() + at + count * sizeof(particles::Id), count});
      read(heap.back());
    }
    at += size;
  }
  std::make_heap(heap.begin(), heap.end(), later);
  while (!heap.empty()) {
    std::pop_heap(heap.begin(), heap.end(), later);
    Run& run = heap.back();
    std::int32_t part = 0;
    std::memcpy(&part, run.parts, sizeof part);
    all.id.push_back(run.id);
    all.part.push_back(part);
    run.ids += sizeof run.id;
    run.parts += sizeof part;
    if (--run.left == 0) {
      heap.pop_back();
      continue;
    }
    read(run);
    std::push_heap(heap.begin(), heap.end(), later);
  }
}

}  // namespace

void gather_changes(comm::Comm& comm, PartChanges& local, std::uint64_t most, PartChanges& all, std::uint64_t at_once) {
  sort_by_id(local);
  std::vector<particles::Id> ends = window_ends(comm, local.id, most, at_once);
  ends.push_back(std::numeric_limits<particles::Id>::max());
  if (comm.rank() == 0) {
    all.id.reserve(most);
    all.part.reserve(most);
  }
  Buffer<std::byte> packed;
  Buffer<std::byte> bytes;
  std::vector<std::size_t> sizes;
  std::size_t begin = 0;
  for (const particles::Id last : ends) {
    const auto end =
        static_cast<std::size_t>(std::upper_bound(local.id.begin() + begin, local.id.end(), last) - local.id.begin());
    packed.clear();
    packed.append(std::as_bytes(local.id.span().subspan(begin, end - begin)));
    packed.append(std::as_bytes(local.part.span().subspan(begin, end - begin)));
    begin = end;
    comm.gather(std::as_const(packed).span(), 0, bytes, sizes);
    merge_runs(bytes, sizes, all);
  }
  local = {};
}

}  // namespace rcb::service
