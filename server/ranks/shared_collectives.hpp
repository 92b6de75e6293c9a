// SharedCollectives: reductions and gathers of ranks on one machine, through memory that they share. Each writes what
// it has into a slot of its own, and the last one to arrive combines the slots. That takes one wait for all others,
// where MPI's algorithms take several messages one after the other, each of which waits until its sender gets a core.
//
// Invariants
// 1. Slots come in two sets that take turns. A rank writes into a set again only when all have arrived at the
// collective
//    between, so all have read what it held before.
// 2. A rank that waits yields its core, and calls MPI now and then: MPI may still hold a part of a message that it
//    reported as sent, and others may wait for that part.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <vector>

#include <mpi.h>

#include "common/base/buffer.hpp"
#include "common/files/shared_memory.hpp"

namespace rcb::ranks {

class SharedCollectives {
 public:
  // A slot holds so many bytes; what is more takes several rounds.
  static constexpr std::size_t kSlotBytes = std::size_t{32} << 10U;
  // More ranks leave reductions to MPI: one rank alone would read all slots.
  static constexpr int kRanksMax = 64;

  // nullopt, on all ranks, where they can't share memory, or are too many or one alone. An error of MPI must end the
  // job (the error handler of `comm`), and `comm` must outlive this. Collective.
  //   able  false, in tests only: as though this rank couldn't
  static std::optional<SharedCollectives> create(MPI_Comm comm, bool able = true);

  // As in Comm. Collective.
  //   between  called on rank 0 alone, with what all have reduced, before they get it; empty: nothing happens between
  void reduce(std::span<std::uint64_t> values, MPI_Op operation,
              const std::function<void(std::span<std::uint64_t>)>& between = {});
  void all_gather(std::span<const std::byte> local, Buffer<std::byte>& all, std::vector<std::size_t>& sizes);

 private:
  // At the beginning of the memory; the slots follow.
  struct Head {
    alignas(64) std::uint64_t mark;                  // tells that this is the job's memory
    alignas(64) std::atomic<std::uint64_t> arrived;  // ranks, in all rounds so far
    alignas(64) std::atomic<std::uint64_t> done;     // rounds
  };
  static_assert(std::atomic<std::uint64_t>::is_always_lock_free);

  SharedCollectives(MPI_Comm comm, SharedMemory memory);

  Head& head() const { return *reinterpret_cast<Head*>(memory_.writable().data()); }
  // This round's slot of a rank; behind those of the ranks follows the one for what is combined.
  std::byte* slot(int rank) const;
  // Waits until all ranks have arrived, and one of them, the last or else the first rank, has called `combine`.
  template <typename Combine>
  void meet(bool first, Combine combine);
  void wait(const std::atomic<std::uint64_t>& count, std::uint64_t until) const;

  MPI_Comm comm_;
  int rank_ = 0;
  int size_ = 1;
  std::uint64_t round_ = 0;
  SharedMemory memory_;
};

}  // namespace rcb::ranks
