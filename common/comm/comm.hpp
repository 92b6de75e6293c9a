// Room `comm`: communication between ranks, and the collectives built on it (gathers, sums of 128 bits). It knows
// nothing of particles. Every function here is Collective, and the order of its messages is part of its contract.
//
// Comm: the interface to the other ranks. All code above it runs unchanged on threads (tests) and on MPI
// (server/ranks). Counts and sizes are 64-bit; an implementation splits what its transport can't carry in one message.
//
// Every method is Collective: all ranks call it, in the same order, with matching arguments. A transport that fails
// ends the job, since the ranks could no longer agree on anything; so nothing here returns a status.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "common/base/buffer.hpp"

namespace rcb::comm {

// Returns whether a long computation may go on, the same on all ranks. Collective. An empty function means yes.
using GoOn = std::function<bool()>;

class Comm {
 public:
  virtual ~Comm() = default;
  virtual int rank() const = 0;
  virtual int size() const = 0;
  // Whether a collective costs a network's latency, so that few large ones are better than many small ones. The same on
  // all ranks. Local.
  virtual bool over_network() const { return false; }

  // values[i] becomes the sum, minimum or maximum of all ranks' values[i], on every rank. Sums wrap at 2^64.
  virtual void all_sum(std::span<std::uint64_t> values) = 0;
  virtual void all_min(std::span<std::uint64_t> values) = 0;
  virtual void all_max(std::span<std::uint64_t> values) = 0;

  // Every rank's bytes, in rank order, on every rank; `sizes` gets the number of bytes of each rank.
  virtual void all_gather(std::span<const std::byte> local, Buffer<std::byte>& all,
                          std::vector<std::size_t>& sizes) = 0;
  // Like all_gather, where nobody asks who sent what and all shares together are small. On very many ranks nothing of
  // it grows with their number.
  virtual void all_gather_few(std::span<const std::byte> local, Buffer<std::byte>& all);
  // Like all_gather, on `root` alone (elsewhere `all` and `sizes` come back empty).
  virtual void gather(std::span<const std::byte> local, int root, Buffer<std::byte>& all,
                      std::vector<std::size_t>& sizes) = 0;
  // root's bytes to every rank; all ranks pass the same size.
  virtual void broadcast(std::span<std::byte> bytes, int root) = 0;
  // send[r] arrives on rank r in receive[s], where s is the sender's rank; both sides know the sizes.
  virtual void exchange(std::span<const std::span<const std::byte>> send,
                        std::span<const std::span<std::byte>> receive) = 0;
  virtual void barrier() = 0;
};

// Collectives built on the methods above.

// What is sent many at a time goes in messages of about this size at most, so that no buffer grows with the problem.
inline constexpr std::size_t kMessageBytesMax = 32 * 1024;
inline constexpr std::size_t kMessageWordsMax = kMessageBytesMax / sizeof(std::uint64_t);

// Comm::all_min in such messages; returns their number. Collective.
std::uint64_t all_min_in_messages(Comm& comm, std::span<std::uint64_t> values);

// from[r] becomes what rank r has in to[this rank]. Collective.
void exchange_counts(Comm& comm, std::span<const std::uint64_t> to, std::span<std::uint64_t> from);

// True on every rank if `here` is true on every rank. Collective; use before any branch on a local error.
bool agree(Comm& comm, bool here);

}  // namespace rcb::comm
