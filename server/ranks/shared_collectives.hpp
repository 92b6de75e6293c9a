// SharedCollectives: reductions and gathers of ranks on one machine, through memory that they share. Each writes what
// it has into a slot of its own, and the last one to arrive combines the slots. That takes one wait for all others,
// where MPI's algorithms take several messages one after the other, each of which waits until its sender gets a core.
//
// Invariants
// 1. Slots come in two sets, used in turn. Before a rank writes into a set again, all have arrived at the round
// between,
//    so all have read what the set held.
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
  //   wanted  false: this rank gets nothing, `all` and `sizes` come back empty
  void all_gather(std::span<const std::byte> local, Buffer<std::byte>& all, std::vector<std::size_t>& sizes,
                  bool wanted = true);

 private:
  // At the beginning of the memory; the slots follow.
  struct Head {
    alignas(64) std::uint64_t mark;                  // tells that this is the job's memory
    alignas(64) std::atomic<std::uint64_t> arrived;  // ranks, in all rounds so far
    alignas(64) std::atomic<std::uint64_t> done;     // rounds
  };
  static_assert(std::atomic<std::uint64_t>::is_always_lock_free);

  // Where the others find the memory that rank 0 has made.
  struct Place {
    std::uint64_t mark = 0;
    int process = -1;
    int descriptor = -1;
  };

  SharedCollectives(MPI_Comm comm, SharedMemory memory);

  // Errors: io_error, and `place` stays as it was.
  static Result<SharedMemory> make(std::size_t bytes, Place& place);
  static Head& head_of(const SharedMemory& memory) { return *reinterpret_cast<Head*>(memory.writable().data()); }
  Head& head() const { return head_of(memory_); }
  // This round's slot of a rank; behind those of the ranks follows the one for what is combined.
  std::byte* slot(int rank) const;
  // Waits until all ranks have arrived and one of them, rank 0 if `first`, else the last to arrive, has called
  // `combine`.
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
