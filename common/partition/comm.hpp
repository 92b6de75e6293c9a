// Comm: the seam to the other ranks. Everything above it runs alike on threads (tests), on one process
// (SelfComm) and on MPI (server/ranks). Counts and sizes are 64-bit; an implementation splits what its
// transport can't carry at once.
//
// Every method is Collective: all ranks call it, in the same order, with matching arguments. A transport
// that fails ends the job (the ranks could not agree on anything any more), so nothing here returns a status.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

namespace rcb::partition {

// Whether work may go on; the same on all ranks. Collective. Empty: it may.
using GoOn = std::function<bool()>;

class Comm {
 public:
  virtual ~Comm() = default;
  virtual int rank() const = 0;
  virtual int size() const = 0;

  // values[i] becomes the sum, least or greatest of all ranks' values[i], on every rank. Sums wrap at 2^64.
  virtual void all_sum(std::span<std::uint64_t> values) = 0;
  virtual void all_min(std::span<std::uint64_t> values) = 0;
  virtual void all_max(std::span<std::uint64_t> values) = 0;

  // Every rank's bytes, in rank order, on every rank; `sizes` gets each rank's share.
  virtual void all_gather(std::span<const std::byte> local, std::vector<std::byte>& all,
                          std::vector<std::size_t>& sizes) = 0;
  // The same, on `root` alone (elsewhere `all` and `sizes` come back empty).
  virtual void gather(std::span<const std::byte> local, int root, std::vector<std::byte>& all,
                      std::vector<std::size_t>& sizes) = 0;
  // root's bytes to every rank; all ranks pass the same size.
  virtual void broadcast(std::span<std::byte> bytes, int root) = 0;
  // Piece r of root's `pieces` arrives in rank r's `mine`, whose size both know. Others pass no pieces.
  virtual void scatter(std::span<const std::span<const std::byte>> pieces, int root, std::span<std::byte> mine) = 0;
  // send[r] goes to rank r and arrives in its receive[rank()]; both sides know the sizes.
  virtual void exchange(std::span<const std::span<const std::byte>> send,
                        std::span<const std::span<std::byte>> receive) = 0;
  virtual void barrier() = 0;
};

// Collectives made of the ones above.

// out[r] = what rank r put in its to[rank()]. Collective.
void exchange_counts(Comm& comm, std::span<const std::uint64_t> to, std::span<std::uint64_t> from);

// True on every rank if `here` is true on every rank. Collective; use before any branch on a local error.
bool agree(Comm& comm, bool here);

}  // namespace rcb::partition
