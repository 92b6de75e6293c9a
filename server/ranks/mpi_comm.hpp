// MpiComm: Comm implemented with MPI. A failed MPI call prints MPI's error text and ends the job.
//
// Invariants
// 1. It works on its own duplicate of the communicator, freed with it (unless MPI has been finalised).
// 2. Messages larger than kMessageBytesMax and reductions of more than kReduceValuesMax values are split.
// 3. It is called by one thread only, the engine thread (MPI_THREAD_FUNNELED).
// 4. Ranks of one machine reduce through shared memory (shared_collectives.hpp); they gather so, too, where there is no
//    other machine, but what is much for one rank (kSharedGatherBytes) goes to it by messages. Of several machines the
//    leaders, their first ranks, reduce among themselves what their machines have reduced. If a machine's ranks can't
//    share memory, none use it.
// 5. Between machines short reductions (of the leaders, or else of all ranks) and gathers (of all ranks) go from each
//    straight to every other: one latency of the network, where MPI takes log2(ranks), twice that if the ranks are no
//    power of two.
// 6. With more than kTellAllRanksMax ranks few values are gathered along a tree and broadcast: in a gather every rank
//    hears of every other, if only that it has nothing.
#pragma once

#include <cstddef>
#include <optional>

#include <mpi.h>

#include "common/comm/comm.hpp"
#include "server/ranks/shared_collectives.hpp"

namespace rcb::ranks {

class MpiComm final : public comm::Comm {
 public:
  // MPI counts are ints, so larger messages are sent in pieces.
  static constexpr std::size_t kMessageBytesMax = std::size_t{1} << 30U;
  // Run times of Open MPI's reductions are steady up to 32 KiB (4096 values) and erratic beyond.
  static constexpr std::size_t kReduceValuesMax = 4096;

  // Between machines a message goes straight to all other ranks while (size - 1) * (bytes + kStraightMessageBytes) is
  // at most kStraightBytesMax: beyond that bytes cost more than latencies. kStraightMessageBytes is the fixed cost of a
  // message.
  static constexpr std::size_t kStraightBytesMax = std::size_t{144} << 10U;
  static constexpr std::size_t kStraightMessageBytes = std::size_t{4} << 10U;

  // With more ranks all_gather_few() uses a tree: the sizes alone, 8 bytes of each rank, would take more than 32 KiB.
  static constexpr int kTellAllRanksMax = 4096;
  static constexpr int kTreeFanOut = 16;

  // What only tests change.
  struct Ways {
    bool shared_memory = true;     // between ranks of one machine
    int rank_without_memory = -1;  // >= 0: as though this one could share none
    std::size_t message_bytes_max = kMessageBytesMax;
    int ranks_of_machine = 0;  // > 0: as though every machine had so many
    int tell_all_ranks_max = kTellAllRanksMax;
  };

  // Collective over `parent`. MPI must be initialised.
  explicit MpiComm(MPI_Comm parent) : MpiComm(parent, Ways{}) {}
  MpiComm(MPI_Comm parent, const Ways& ways);
  ~MpiComm() override;
  MpiComm(const MpiComm&) = delete;
  MpiComm& operator=(const MpiComm&) = delete;

  int rank() const override { return everyone_.rank; }
  int size() const override { return everyone_.size; }
  bool over_network() const override { return leaders_.size > 1; }
  void all_sum(std::span<std::uint64_t> values) override;
  void all_min(std::span<std::uint64_t> values) override;
  void all_max(std::span<std::uint64_t> values) override;
  void all_gather(std::span<const std::byte> local, Buffer<std::byte>& all, std::vector<std::size_t>& sizes) override;
  void all_gather_few(std::span<const std::byte> local, Buffer<std::byte>& all) override;
  void gather(std::span<const std::byte> local, int root, Buffer<std::byte>& all,
              std::vector<std::size_t>& sizes) override;
  void broadcast(std::span<std::byte> bytes, int root) override;
  void exchange(std::span<const std::span<const std::byte>> send,
                std::span<const std::span<std::byte>> receive) override;
  void barrier() override;
  // Whether every machine's ranks share memory. The same on all ranks. Local.
  bool shares_memory() const { return shares_memory_; }
  // Sends on what MPI still holds of messages that it has taken for sent. Local.
  void progress();

 private:
  struct Group {
    MPI_Comm comm = MPI_COMM_NULL;
    int rank = 0;
    int size = 1;
  };
  // Sets rank and size of a group whose communicator is new.
  void measure(Group& group) const;
  // Sets the other two groups, and what their ranks share. Collective.
  void find_machines();
  void reduce(std::span<std::uint64_t> values, MPI_Op operation, const char* name);
  // By messages.
  void reduce_among(const Group& group, std::span<std::uint64_t> values, MPI_Op operation, const char* name);
  // Whether messages of this size go straight to every other rank of a group.
  bool straight(const Group& group, std::size_t bytes) const;
  // Sends `mine` to every other rank, and receives theirs, which may be shorter than their shares of `all`.
  void tell_all(const Group& group, std::span<const std::byte> mine, std::span<std::byte> all, const char* name);
  void start_send(std::span<const std::byte> bytes, int to, std::vector<MPI_Request>& requests) {
    start_send(everyone_, bytes, to, requests);
  }
  void start_receive(std::span<std::byte> bytes, int from, std::vector<MPI_Request>& requests) {
    start_receive(everyone_, bytes, from, requests);
  }
  void start_send(const Group& group, std::span<const std::byte> bytes, int to, std::vector<MPI_Request>& requests);
  void start_receive(const Group& group, std::span<std::byte> bytes, int from, std::vector<MPI_Request>& requests);
  void finish(std::vector<MPI_Request>& requests, const char* name);
  // Ends the job if `result` is a failure.
  void must(int result, const char* name) const;

  Group everyone_;
  Group machine_;  // the ranks of this machine
  Group leaders_;  // the first rank of each machine; on all others only its size is right
  Ways ways_;
  std::optional<SharedCollectives> shared_;              // among the ranks of this machine
  bool shares_memory_ = false;                           // every machine's ranks share memory
  static constexpr std::size_t kEagerBytes = 32 * 1024;  // first message of all_gather, all ranks together
  // Gathers of so many bytes, all ranks together, go through shared memory where that is possible.
  static constexpr std::size_t kSharedGatherBytes = std::size_t{2} << 20U;
};

}  // namespace rcb::ranks
