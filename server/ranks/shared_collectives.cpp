#include "server/ranks/shared_collectives.hpp"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <new>
#include <numeric>
#include <random>

#include <fcntl.h>
#include <sched.h>
#include <unistd.h>

namespace rcb::ranks {
namespace {

std::size_t slot_offset(std::size_t number) { return 4096 + number * SharedCollectives::kSlotBytes; }

}  // namespace

Result<SharedMemory> SharedCollectives::make(std::size_t bytes, Place& place) {
  Result<SharedMemory> memory = SharedMemory::create(bytes);
  if (!memory.ok()) return memory;
  // Without this a page that there is no memory for would end the rank that touches it first, however late.
  while (::fallocate(memory->descriptor(), 0, 0, static_cast<off_t>(bytes)) != 0)
    if (errno != EINTR) return Status(Code::io_error, std::strerror(errno));
  std::random_device random;
  place = {std::uint64_t{random()} << 32U | random(), ::getpid(), memory->descriptor()};
  new (memory->writable().data()) Head{.mark = place.mark, .arrived = 0, .done = 0};
  return memory;
}

std::optional<SharedCollectives> SharedCollectives::create(MPI_Comm comm, bool able) {
  int rank = 0;
  int size = 1;
  MPI_Comm_rank(comm, &rank);
  MPI_Comm_size(comm, &size);
  if (size < 2 || size > kRanksMax) return std::nullopt;
  const std::size_t bytes = slot_offset(2 * static_cast<std::size_t>(size) + 1);
  // Rank 0 makes the memory, the others find it in /proc.
  Place place;
  Result<SharedMemory> memory = rank == 0 ? make(bytes, place) : SharedMemory();
  MPI_Bcast(&place, sizeof place, MPI_BYTE, 0, comm);
  if (rank != 0) memory = SharedMemory::join(place.process, place.descriptor, bytes);
  if (memory.ok()) able &= head_of(*memory).mark == place.mark;
  int all_able = able && memory.ok() ? 1 : 0;
  MPI_Allreduce(MPI_IN_PLACE, &all_able, 1, MPI_INT, MPI_MIN, comm);
  if (all_able == 0) return std::nullopt;
  return SharedCollectives(comm, std::move(*memory));
}

SharedCollectives::SharedCollectives(MPI_Comm comm, SharedMemory memory) : comm_(comm), memory_(std::move(memory)) {
  MPI_Comm_rank(comm, &rank_);
  MPI_Comm_size(comm, &size_);
}

std::byte* SharedCollectives::slot(int rank) const {
  const auto ranks = static_cast<std::size_t>(size_);
  const std::size_t number = rank < size_ ? (round_ % 2) * ranks + static_cast<std::size_t>(rank) : 2 * ranks;
  return memory_.writable().data() + slot_offset(number);
}

template <typename Combine>
void SharedCollectives::meet(bool first, Combine combine) {
  const std::uint64_t rounds = round_ + 1;
  const std::uint64_t all = rounds * static_cast<std::uint64_t>(size_);
  const bool last = head().arrived.fetch_add(1, std::memory_order_acq_rel) + 1 == all;
  if (first ? rank_ != 0 : !last) return wait(head().done, rounds);
  wait(head().arrived, all);
  combine();
  head().done.store(rounds, std::memory_order_release);
}

void SharedCollectives::wait(const std::atomic<std::uint64_t>& count, std::uint64_t until) const {
  constexpr std::uint64_t kPauses = 32;  // before it yields its core
  constexpr std::uint64_t kYields = 8;   // between two calls of MPI
  for (std::uint64_t turn = 0; count.load(std::memory_order_acquire) < until; ++turn) {
    if (turn < kPauses) continue;
    int any = 0;
    if (turn % kYields == 0) MPI_Iprobe(MPI_ANY_SOURCE, MPI_ANY_TAG, comm_, &any, MPI_STATUS_IGNORE);
    ::sched_yield();
  }
}

void SharedCollectives::reduce(std::span<std::uint64_t> values, MPI_Op operation,
                               const std::function<void(std::span<std::uint64_t>)>& between) {
  while (!values.empty()) {
    const auto own = values.first(std::min(values.size(), kSlotBytes / sizeof(std::uint64_t)));
    const std::span all(reinterpret_cast<std::uint64_t*>(slot(size_)), own.size());
    std::memcpy(slot(rank_), own.data(), own.size_bytes());
    meet(static_cast<bool>(between), [&] {
      std::memcpy(all.data(), slot(0), own.size_bytes());
      for (int r = 1; r < size_; ++r)
        MPI_Reduce_local(slot(r), all.data(), static_cast<int>(own.size()), MPI_UINT64_T, operation);
      if (between) between(all);
    });
    std::memcpy(own.data(), all.data(), own.size_bytes());
    ++round_;
    values = values.subspan(own.size());
  }
}

void SharedCollectives::all_gather(std::span<const std::byte> local, Buffer<std::byte>& all,
                                   std::vector<std::size_t>& sizes, bool wanted) {
  static constexpr std::size_t kRoom = kSlotBytes - sizeof(std::uint64_t);
  const auto ranks = static_cast<std::size_t>(size_);
  const auto piece = [](std::size_t size, std::size_t sent) { return std::min(kRoom, size - std::min(size, sent)); };
  std::vector<std::size_t> starts(ranks, 0);
  sizes.assign(ranks, 0);
  std::size_t sent = 0;
  do {
    const std::uint64_t size = local.size();
    std::memcpy(slot(rank_), &size, sizeof size);
    if (const std::size_t own = piece(size, sent); own > 0)
      std::memcpy(slot(rank_) + sizeof size, local.data() + sent, own);
    meet(false, [] {});
    if (sent == 0) {
      for (std::size_t r = 0; r < ranks; ++r) {
        std::uint64_t theirs = 0;
        std::memcpy(&theirs, slot(static_cast<int>(r)), sizeof theirs);
        sizes[r] = theirs;
      }
      std::exclusive_scan(sizes.begin(), sizes.end(), starts.begin(), std::size_t{0});
      all.resize(wanted ? starts.back() + sizes.back() : 0);
    }
    for (std::size_t r = 0; r < ranks && wanted; ++r)
      if (const std::size_t theirs = piece(sizes[r], sent); theirs > 0)
        std::memcpy(all.data() + starts[r] + sent, slot(static_cast<int>(r)) + sizeof(std::uint64_t), theirs);
    ++round_;
    sent += kRoom;
  } while (sent < std::ranges::max(sizes));
  if (!wanted) sizes.clear();
}

}  // namespace rcb::ranks
