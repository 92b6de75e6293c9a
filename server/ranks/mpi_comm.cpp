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

constexpr int kTag = 1;  // MPI keeps the order of messages between two ranks, so one tag is enough

void copy(std::span<const std::byte> from, std::span<std::byte> to) {
  CHECK(from.size() == to.size(), "both sides know the size");
  if (!from.empty()) std::memmove(to.data(), from.data(), from.size());
}

}  // namespace

MpiComm::MpiComm(MPI_Comm parent, std::size_t message_bytes_max, bool apart, int tell_all_ranks_max)
    : message_bytes_max_(message_bytes_max), apart_(apart), tell_all_ranks_max_(tell_all_ranks_max) {
  CHECK(message_bytes_max > 0 && message_bytes_max <= kMessageBytesMax, "MPI counts are ints");
  must(MPI_Comm_dup(parent, &comm_), "MPI_Comm_dup");
  must(MPI_Comm_set_errhandler(comm_, MPI_ERRORS_RETURN), "MPI_Comm_set_errhandler");
  must(MPI_Comm_rank(comm_, &rank_), "MPI_Comm_rank");
  must(MPI_Comm_size(comm_, &size_), "MPI_Comm_size");
  MPI_Comm machine = MPI_COMM_NULL;
  must(MPI_Comm_split_type(comm_, MPI_COMM_TYPE_SHARED, 0, MPI_INFO_NULL, &machine), "MPI_Comm_split_type");
  int here = 0;
  must(MPI_Comm_size(machine, &here), "MPI_Comm_size");
  must(MPI_Comm_free(&machine), "MPI_Comm_free");
  apart_ = apart_ || here < size_;
}

MpiComm::~MpiComm() {
  int finalized = 0;
  MPI_Finalized(&finalized);
  if (finalized == 0) MPI_Comm_free(&comm_);
}

void MpiComm::must(int result, const char* name) const {
  if (result == MPI_SUCCESS) [[likely]]
    return;
  std::array<char, MPI_MAX_ERROR_STRING> text{};
  int length = 0;
  MPI_Error_string(result, text.data(), &length);
  std::fprintf(stderr, "rcbd: rank %d of %d: %s failed: %s; the job ends\n", rank_, size_, name, text.data());
  std::fflush(stderr);
  MPI_Abort(MPI_COMM_WORLD, 1);
  std::abort();
}

void MpiComm::reduce(std::span<std::uint64_t> values, MPI_Op operation, const char* name) {
  while (!values.empty()) {
    const std::size_t count = std::min(values.size(), kReduceValuesMax);
    if (straight(count * sizeof(std::uint64_t))) {
      std::vector<std::uint64_t> all(count * static_cast<std::size_t>(size_));
      tell_all(std::as_bytes(values.first(count)), std::as_writable_bytes(std::span(all)), name);
      for (int r = 0; r < size_; ++r)
        if (r != rank_)
          must(MPI_Reduce_local(&all[count * static_cast<std::size_t>(r)], values.data(), static_cast<int>(count),
                                MPI_UINT64_T, operation),
               name);
    } else {
      must(MPI_Allreduce(MPI_IN_PLACE, values.data(), static_cast<int>(count), MPI_UINT64_T, operation, comm_), name);
    }
    values = values.subspan(count);
  }
}

void MpiComm::all_sum(std::span<std::uint64_t> values) { reduce(values, MPI_SUM, "MPI_Allreduce (sum)"); }
void MpiComm::all_min(std::span<std::uint64_t> values) { reduce(values, MPI_MIN, "MPI_Allreduce (min)"); }
void MpiComm::all_max(std::span<std::uint64_t> values) { reduce(values, MPI_MAX, "MPI_Allreduce (max)"); }

bool MpiComm::straight(std::size_t bytes) const {
  return apart_ && bytes <= message_bytes_max_ &&
         (bytes + kStraightMessageBytes) * static_cast<std::size_t>(size_ - 1) <= kStraightBytesMax;
}

void MpiComm::tell_all(std::span<const std::byte> mine, std::span<std::byte> all, const char* name) {
  const std::size_t room = all.size() / static_cast<std::size_t>(size_);
  std::vector<MPI_Request> requests;
  for (int r = 0; r < size_; ++r)
    if (r != rank_) start_receive(all.subspan(room * static_cast<std::size_t>(r), room), r, requests);
  for (int k = 1; k < size_; ++k) start_send(mine, (rank_ + k) % size_, requests);
  finish(requests, name);
}

void MpiComm::start_send(std::span<const std::byte> bytes, int to, std::vector<MPI_Request>& requests) {
  while (!bytes.empty()) {
    const std::size_t count = std::min(bytes.size(), message_bytes_max_);
    must(MPI_Isend(bytes.data(), static_cast<int>(count), MPI_BYTE, to, kTag, comm_, &requests.emplace_back()),
         "MPI_Isend");
    bytes = bytes.subspan(count);
  }
}

void MpiComm::start_receive(std::span<std::byte> bytes, int from, std::vector<MPI_Request>& requests) {
  while (!bytes.empty()) {
    const std::size_t count = std::min(bytes.size(), message_bytes_max_);
    must(MPI_Irecv(bytes.data(), static_cast<int>(count), MPI_BYTE, from, kTag, comm_, &requests.emplace_back()),
         "MPI_Irecv");
    bytes = bytes.subspan(count);
  }
}

void MpiComm::finish(std::vector<MPI_Request>& requests, const char* name) {
  must(MPI_Waitall(narrow<int>(requests.size()), requests.data(), MPI_STATUSES_IGNORE), name);
}

void MpiComm::all_gather(std::span<const std::byte> local, Buffer<std::byte>& all, std::vector<std::size_t>& sizes) {
  const auto ranks = static_cast<std::size_t>(size_);
  sizes.assign(ranks, 0);
  // One message with the sizes and, if they are small, the bytes themselves: a second message costs more than some
  // unused bytes.
  const std::size_t room = kEagerBytes / ranks;
  std::vector<std::byte> mine(sizeof(std::uint64_t) + room);
  const std::uint64_t size = local.size();
  std::memcpy(mine.data(), &size, sizeof size);
  copy(local.first(std::min(room, local.size())), std::span(mine).subspan(sizeof size, std::min(room, local.size())));
  std::vector<std::byte> first(mine.size() * ranks);
  if (straight(mine.size())) {
    const auto used = std::span(mine).first(sizeof size + std::min(room, local.size()));
    copy(used, std::span(first).subspan(mine.size() * static_cast<std::size_t>(rank_), used.size()));
    tell_all(used, first, "MPI_Waitall (all_gather)");
  } else {
    const auto count = narrow<int>(mine.size());
    must(MPI_Allgather(mine.data(), count, MPI_BYTE, first.data(), count, MPI_BYTE, comm_), "MPI_Allgather");
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
  if (total <= message_bytes_max_) {
    std::vector<int> counts(ranks);
    std::vector<int> starts(ranks);
    for (std::size_t r = 0, start = 0; r < ranks; start += sizes[r++]) {
      counts[r] = static_cast<int>(sizes[r]);
      starts[r] = static_cast<int>(start);
    }
    must(MPI_Allgatherv(local.data(), counts[static_cast<std::size_t>(rank_)], MPI_BYTE, all.data(), counts.data(),
                        starts.data(), MPI_BYTE, comm_),
         "MPI_Allgatherv");
    return;
  }
  std::size_t start = 0;
  for (int r = 0; r < size_; ++r) {
    const std::span<std::byte> share(all.data() + start, sizes[static_cast<std::size_t>(r)]);
    if (r == rank_) copy(local, share);
    broadcast(share, r);
    start += share.size();
  }
}

void MpiComm::all_gather_few(std::span<const std::byte> local, Buffer<std::byte>& all) {
  if (size_ <= tell_all_ranks_max_) return Comm::all_gather_few(local, all);
  const comm::TreePlace place = comm::place_in_tree(rank_, size_, kTreeFanOut);
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
  const bool here = rank_ == root;
  const auto ranks = static_cast<std::size_t>(size_);
  const std::uint64_t mine = local.size();
  std::vector<std::uint64_t> shares(here ? ranks : 0, mine);
  std::vector<MPI_Request> requests;
  // Straight to the root, as the bytes that follow: on MPI_Gather's way through other ranks they would wait.
  for (int r = 0; here && r < size_; ++r)
    if (r != root)
      start_receive(std::as_writable_bytes(std::span(shares).subspan(static_cast<std::size_t>(r), 1)), r, requests);
  if (here)
    finish(requests, "MPI_Waitall (gather)");
  else
    start_send(std::as_bytes(std::span(&mine, 1)), root, requests);
  all.clear();
  sizes.assign(shares.begin(), shares.end());
  if (here) {
    requests.clear();
    all.resize(std::accumulate(sizes.begin(), sizes.end(), std::size_t{0}));
    std::size_t start = 0;
    for (int r = 0; r < size_; ++r) {
      const std::span<std::byte> share(all.data() + start, sizes[static_cast<std::size_t>(r)]);
      if (r == rank_)
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
    const std::size_t count = std::min(bytes.size(), message_bytes_max_);
    must(MPI_Bcast(bytes.data(), static_cast<int>(count), MPI_BYTE, root, comm_), "MPI_Bcast");
    bytes = bytes.subspan(count);
  }
}

void MpiComm::scatter(std::span<const std::span<const std::byte>> pieces, int root, std::span<std::byte> mine) {
  CHECK(pieces.size() == (rank_ == root ? static_cast<std::size_t>(size_) : 0), "root alone brings pieces");
  std::vector<MPI_Request> requests;
  if (rank_ == root) {
    for (int r = 0; r < size_; ++r)
      if (r != rank_) start_send(pieces[static_cast<std::size_t>(r)], r, requests);
    copy(pieces[static_cast<std::size_t>(rank_)], mine);
  } else {
    start_receive(mine, root, requests);
  }
  finish(requests, "MPI_Waitall (scatter)");
}

void MpiComm::exchange(std::span<const std::span<const std::byte>> send,
                       std::span<const std::span<std::byte>> receive) {
  const auto ranks = static_cast<std::size_t>(size_);
  CHECK(send.size() == ranks && receive.size() == ranks, "one piece a rank");
  std::vector<MPI_Request> requests;
  for (int r = 0; r < size_; ++r)
    if (r != rank_) start_receive(receive[static_cast<std::size_t>(r)], r, requests);
  for (int r = 0; r < size_; ++r)
    if (r != rank_) start_send(send[static_cast<std::size_t>(r)], r, requests);
  copy(send[static_cast<std::size_t>(rank_)], receive[static_cast<std::size_t>(rank_)]);
  finish(requests, "MPI_Waitall (exchange)");
}

void MpiComm::barrier() { must(MPI_Barrier(comm_), "MPI_Barrier"); }

// A call moves on one fragment or so of each message.
void MpiComm::progress() {
  constexpr int kCalls = 16;
  int any = 0;
  for (int k = 0; k < kCalls; ++k)
    must(MPI_Iprobe(MPI_ANY_SOURCE, MPI_ANY_TAG, comm_, &any, MPI_STATUS_IGNORE), "MPI_Iprobe");
}

}  // namespace rcb::ranks
