#include "server/ranks/mpi_comm.hpp"

#include <algorithm>
#include <array>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <numeric>

#include "common/base/check.hpp"
#include "common/base/narrow.hpp"
#include "common/comm/tree.hpp"

namespace rcb::ranks {
namespace {

// Machines with one rank and with several cut what their leaders reduce into the same pieces.
static_assert(SharedCollectives::kSlotBytes / sizeof(std::uint64_t) == MpiComm::kReduceValuesMax);

constexpr int kTag = 1;  // MPI keeps the order of messages between two ranks, so one tag is enough

void copy(std::span<const std::byte> from, std::span<std::byte> to) {
  RCB_CHECK(from.size() == to.size(), "both sides know the size");
  if (!from.empty()) std::memmove(to.data(), from.data(), from.size());
}

}  // namespace

MpiComm::MpiComm(MPI_Comm parent, const Ways& ways) : ways_(ways) {
  RCB_CHECK(ways.message_bytes_max > 0 && ways.message_bytes_max <= kMessageBytesMax, "MPI counts are ints");
  must(MPI_Comm_dup(parent, &everyone_.comm), "MPI_Comm_dup");
  measure(everyone_);
  find_machines();
}

void MpiComm::measure(Group& group) const {
  must(MPI_Comm_set_errhandler(group.comm, MPI_ERRORS_RETURN), "MPI_Comm_set_errhandler");
  must(MPI_Comm_rank(group.comm, &group.rank), "MPI_Comm_rank");
  must(MPI_Comm_size(group.comm, &group.size), "MPI_Comm_size");
}

void MpiComm::find_machines() {
  if (ways_.ranks_of_machine > 0)
    must(MPI_Comm_split(everyone_.comm, everyone_.rank / ways_.ranks_of_machine, everyone_.rank, &machine_.comm),
         "MPI_Comm_split");
  else
    must(MPI_Comm_split_type(everyone_.comm, MPI_COMM_TYPE_SHARED, everyone_.rank, MPI_INFO_NULL, &machine_.comm),
         "MPI_Comm_split_type");
  measure(machine_);
  must(MPI_Comm_set_errhandler(machine_.comm, MPI_ERRORS_ARE_FATAL), "MPI_Comm_set_errhandler");
  Group leaders;
  must(MPI_Comm_split(everyone_.comm, machine_.rank == 0 ? 0 : 1, everyone_.rank, &leaders.comm), "MPI_Comm_split");
  measure(leaders);
  std::uint64_t machines = machine_.rank == 0 ? 1 : 0;
  reduce_among(everyone_, {&machines, 1}, MPI_SUM, "MPI_Allreduce (machines)");
  leaders.size = static_cast<int>(machines);
  leaders_ = leaders;
  if (ways_.shared_memory)
    shared_ = SharedCollectives::create(machine_.comm, everyone_.rank != ways_.rank_without_memory);
  std::uint64_t all_share = shared_ || machine_.size == 1 ? 1 : 0;
  reduce_among(everyone_, {&all_share, 1}, MPI_MIN, "MPI_Allreduce (shared memory)");
  shares_memory_ = all_share == 1;
  if (!shares_memory_) shared_.reset();
}

MpiComm::~MpiComm() {
  int finalized = 0;
  MPI_Finalized(&finalized);
  if (finalized != 0) return;
  for (Group* group : {&leaders_, &machine_, &everyone_}) MPI_Comm_free(&group->comm);
}

void MpiComm::must(int result, const char* name) const {
  if (result == MPI_SUCCESS) [[likely]]
    return;
  std::array<char, MPI_MAX_ERROR_STRING> text{};
  int length = 0;
  MPI_Error_string(result, text.data(), &length);
  std::fprintf(stderr, "rcbd: rank %d of %d: %s failed: %s; the job ends\n", everyone_.rank, everyone_.size, name,
               text.data());
  std::fflush(stderr);
  MPI_Abort(MPI_COMM_WORLD, 1);
  std::abort();
}

void MpiComm::reduce(std::span<std::uint64_t> values, MPI_Op operation, const char* name) {
  if (!shares_memory_) return reduce_among(everyone_, values, operation, name);
  if (!shared_) return reduce_among(leaders_, values, operation, name);
  if (leaders_.size == 1) return shared_->reduce(values, operation);
  shared_->reduce(values, operation,
                  [&](std::span<std::uint64_t> of_machine) { reduce_among(leaders_, of_machine, operation, name); });
}

void MpiComm::reduce_among(const Group& group, std::span<std::uint64_t> values, MPI_Op operation, const char* name) {
  while (!values.empty()) {
    const std::size_t count = std::min(values.size(), kReduceValuesMax);
    if (straight(group, count * sizeof(std::uint64_t))) {
      std::vector<std::uint64_t> all(count * static_cast<std::size_t>(group.size));
      tell_all(group, std::as_bytes(values.first(count)), std::as_writable_bytes(std::span(all)), name);
      for (int r = 0; r < group.size; ++r)
        if (r != group.rank)
          must(MPI_Reduce_local(&all[count * static_cast<std::size_t>(r)], values.data(), static_cast<int>(count),
                                MPI_UINT64_T, operation),
               name);
    } else {
      must(MPI_Allreduce(MPI_IN_PLACE, values.data(), static_cast<int>(count), MPI_UINT64_T, operation, group.comm),
           name);
    }
    values = values.subspan(count);
  }
}

void MpiComm::all_sum(std::span<std::uint64_t> values) { reduce(values, MPI_SUM, "MPI_Allreduce (sum)"); }
void MpiComm::all_min(std::span<std::uint64_t> values) { reduce(values, MPI_MIN, "MPI_Allreduce (min)"); }
void MpiComm::all_max(std::span<std::uint64_t> values) { reduce(values, MPI_MAX, "MPI_Allreduce (max)"); }

bool MpiComm::straight(const Group& group, std::size_t bytes) const {
  return over_network() && bytes <= ways_.message_bytes_max &&
         (bytes + kStraightMessageBytes) * static_cast<std::size_t>(group.size - 1) <= kStraightBytesMax;
}

void MpiComm::tell_all(const Group& group, std::span<const std::byte> mine, std::span<std::byte> all,
                       const char* name) {
  const std::size_t room = all.size() / static_cast<std::size_t>(group.size);
  std::vector<MPI_Request> requests;
  for (int r = 0; r < group.size; ++r)
    if (r != group.rank) start_receive(group, all.subspan(room * static_cast<std::size_t>(r), room), r, requests);
  for (int k = 1; k < group.size; ++k) start_send(group, mine, (group.rank + k) % group.size, requests);
  finish(requests, name);
}

void MpiComm::start_send(const Group& group, std::span<const std::byte> bytes, int to,
                         std::vector<MPI_Request>& requests) {
  while (!bytes.empty()) {
    const std::size_t count = std::min(bytes.size(), ways_.message_bytes_max);
    must(MPI_Isend(bytes.data(), static_cast<int>(count), MPI_BYTE, to, kTag, group.comm, &requests.emplace_back()),
         "MPI_Isend");
    bytes = bytes.subspan(count);
  }
}

void MpiComm::start_receive(const Group& group, std::span<std::byte> bytes, int from,
                            std::vector<MPI_Request>& requests) {
  while (!bytes.empty()) {
    const std::size_t count = std::min(bytes.size(), ways_.message_bytes_max);
    must(MPI_Irecv(bytes.data(), static_cast<int>(count), MPI_BYTE, from, kTag, group.comm, &requests.emplace_back()),
         "MPI_Irecv");
    bytes = bytes.subspan(count);
  }
}

void MpiComm::finish(std::vector<MPI_Request>& requests, const char* name) {
  must(MPI_Waitall(narrow<int>(requests.size()), requests.data(), MPI_STATUSES_IGNORE), name);
}

void MpiComm::all_gather(std::span<const std::byte> local, Buffer<std::byte>& all, std::vector<std::size_t>& sizes) {
  if (shared_ && leaders_.size == 1) return shared_->all_gather(local, all, sizes);
  const auto ranks = static_cast<std::size_t>(everyone_.size);
  sizes.assign(ranks, 0);
  // One message with the sizes and, if they are small, the bytes themselves: a second message costs more than some
  // unused bytes.
  const std::size_t room = kEagerBytes / ranks;
  std::vector<std::byte> mine(sizeof(std::uint64_t) + room);
  const std::uint64_t size = local.size();
  std::memcpy(mine.data(), &size, sizeof size);
  copy(local.first(std::min(room, local.size())), std::span(mine).subspan(sizeof size, std::min(room, local.size())));
  std::vector<std::byte> first(mine.size() * ranks);
  if (straight(everyone_, mine.size())) {
    const auto used = std::span(mine).first(sizeof size + std::min(room, local.size()));
    copy(used, std::span(first).subspan(mine.size() * static_cast<std::size_t>(everyone_.rank), used.size()));
    tell_all(everyone_, used, first, "MPI_Waitall (all_gather)");
  } else {
    const auto count = narrow<int>(mine.size());
    must(MPI_Allgather(mine.data(), count, MPI_BYTE, first.data(), count, MPI_BYTE, everyone_.comm), "MPI_Allgather");
  }
  for (std::size_t r = 0; r < ranks; ++r) {
    std::uint64_t share = 0;
    std::memcpy(&share, &first[r * mine.size()], sizeof share);
    sizes[r] = share;
  }
  const std::size_t total = std::accumulate(sizes.begin(), sizes.end(), std::size_t{0});
  all.resize(total);
  if (std::ranges::max(sizes) <= room) {
    for (std::size_t r = 0, start = 0; r < ranks; start += sizes[r++])
      copy(std::span(first).subspan(r * mine.size() + sizeof size, sizes[r]), std::span(all).subspan(start, sizes[r]));
    return;
  }
  if (total <= ways_.message_bytes_max) {
    std::vector<int> counts(ranks);
    std::vector<int> starts(ranks);
    for (std::size_t r = 0, start = 0; r < ranks; start += sizes[r++]) {
      counts[r] = static_cast<int>(sizes[r]);
      starts[r] = static_cast<int>(start);
    }
    must(MPI_Allgatherv(local.data(), counts[static_cast<std::size_t>(everyone_.rank)], MPI_BYTE, all.data(),
                        counts.data(), starts.data(), MPI_BYTE, everyone_.comm),
         "MPI_Allgatherv");
    return;
  }
  std::size_t start = 0;
  for (int r = 0; r < everyone_.size; ++r) {
    const std::span<std::byte> share(all.data() + start, sizes[static_cast<std::size_t>(r)]);
    if (r == everyone_.rank) copy(local, share);
    broadcast(share, r);
    start += share.size();
  }
}

void MpiComm::all_gather_few(std::span<const std::byte> local, Buffer<std::byte>& all) {
  if (everyone_.size <= ways_.tell_all_ranks_max) return Comm::all_gather_few(local, all);
  const comm::TreePlace place = comm::place_in_tree(everyone_.rank, everyone_.size, kTreeFanOut);
  std::vector<MPI_Request> requests;
  std::vector<std::uint64_t> sizes(place.children.size());
  for (std::size_t c = 0; c < sizes.size(); ++c)
    start_receive(std::as_writable_bytes(std::span(sizes).subspan(c, 1)), place.children[c], requests);
  finish(requests, "MPI_Waitall (all_gather_few)");
  requests.clear();
  std::uint64_t total = std::accumulate(sizes.begin(), sizes.end(), std::uint64_t{local.size()});
  all.resize(total);
  copy(local, std::span(all).first(local.size()));
  std::size_t start = local.size();
  for (std::size_t c = 0; c < sizes.size(); start += sizes[c++])
    start_receive(std::span(all).subspan(start, sizes[c]), place.children[c], requests);
  finish(requests, "MPI_Waitall (all_gather_few)");
  requests.clear();
  if (place.parent >= 0) {
    start_send(std::as_bytes(std::span(&total, 1)), place.parent, requests);
    start_send(all, place.parent, requests);
    finish(requests, "MPI_Waitall (all_gather_few)");
  }
  broadcast(std::as_writable_bytes(std::span(&total, 1)), 0);
  all.resize(total);
  broadcast(all, 0);
}

void MpiComm::gather(std::span<const std::byte> local, int root, Buffer<std::byte>& all,
                     std::vector<std::size_t>& sizes) {
  const bool here = everyone_.rank == root;
  const auto ranks = static_cast<std::size_t>(everyone_.size);
  const std::uint64_t mine = local.size();
  std::vector<std::uint64_t> shares(here ? ranks : 0, mine);
  std::vector<MPI_Request> requests;
  all.clear();
  if (shared_ && leaders_.size == 1) {
    Buffer<std::byte> told;
    shared_->all_gather(std::as_bytes(std::span(&mine, 1)), told, sizes);
    const Buffer<std::uint64_t> of_ranks = told.release_as<std::uint64_t>();
    if (std::accumulate(of_ranks.begin(), of_ranks.end(), std::uint64_t{0}) <= kSharedGatherBytes)
      return shared_->all_gather(local, all, sizes, here);
    if (here) shares.assign(of_ranks.begin(), of_ranks.end());
  } else {
    // Straight to the root, as the bytes that follow: on MPI_Gather's way through other ranks they would wait.
    for (int r = 0; here && r < everyone_.size; ++r)
      if (r != root)
        start_receive(std::as_writable_bytes(std::span(shares).subspan(static_cast<std::size_t>(r), 1)), r, requests);
    if (here)
      finish(requests, "MPI_Waitall (gather)");
    else
      start_send(std::as_bytes(std::span(&mine, 1)), root, requests);
  }
  sizes.assign(shares.begin(), shares.end());
  if (here) {
    requests.clear();
    all.resize(std::accumulate(sizes.begin(), sizes.end(), std::size_t{0}));
    std::size_t start = 0;
    for (int r = 0; r < everyone_.size; ++r) {
      const std::span<std::byte> share(all.data() + start, sizes[static_cast<std::size_t>(r)]);
      if (r == everyone_.rank)
        copy(local, share);
      else
        start_receive(share, r, requests);
      start += share.size();
    }
  } else {
    start_send(local, root, requests);
  }
  finish(requests, "MPI_Waitall (gather)");
}

void MpiComm::broadcast(std::span<std::byte> bytes, int root) {
  while (!bytes.empty()) {
    const std::size_t count = std::min(bytes.size(), ways_.message_bytes_max);
    must(MPI_Bcast(bytes.data(), static_cast<int>(count), MPI_BYTE, root, everyone_.comm), "MPI_Bcast");
    bytes = bytes.subspan(count);
  }
}

void MpiComm::exchange(std::span<const std::span<const std::byte>> send,
                       std::span<const std::span<std::byte>> receive) {
  const auto ranks = static_cast<std::size_t>(everyone_.size);
  RCB_CHECK(send.size() == ranks && receive.size() == ranks, "one piece a rank");
  std::vector<MPI_Request> requests;
  for (int r = 0; r < everyone_.size; ++r)
    if (r != everyone_.rank) start_receive(receive[static_cast<std::size_t>(r)], r, requests);
  for (int r = 0; r < everyone_.size; ++r)
    if (r != everyone_.rank) start_send(send[static_cast<std::size_t>(r)], r, requests);
  copy(send[static_cast<std::size_t>(everyone_.rank)], receive[static_cast<std::size_t>(everyone_.rank)]);
  finish(requests, "MPI_Waitall (exchange)");
}

void MpiComm::barrier() { must(MPI_Barrier(everyone_.comm), "MPI_Barrier"); }

// A call moves on one fragment or so of each message.
void MpiComm::progress() {
  constexpr int kCalls = 16;
  int any = 0;
  for (int k = 0; k < kCalls; ++k)
    must(MPI_Iprobe(MPI_ANY_SOURCE, MPI_ANY_TAG, everyone_.comm, &any, MPI_STATUS_IGNORE), "MPI_Iprobe");
}

}  // namespace rcb::ranks
