// ThreadComm: ranks as threads of one process. Every collective is two meetings: all publish what they bring, all
// read, all leave. A meeting at which ranks call different collectives, or that lasts over a minute, is a failed
// RCB_CHECK.
#pragma once

#include <condition_variable>
#include <cstdint>
#include <functional>
#include <mutex>
#include <vector>

#include "common/comm/comm.hpp"

namespace rcb::testing {

class ThreadWorld {
 public:
  explicit ThreadWorld(int ranks);

  int ranks() const { return static_cast<int>(calls_.size()); }

 private:
  friend class ThreadComm;
  struct Call {
    const char* name = nullptr;
    int root = 0;
    std::span<const std::byte> bytes;
    std::span<const std::span<const std::byte>> pieces;
  };
  void meet();

  std::vector<Call> calls_;
  std::mutex mutex_;
  std::condition_variable met_;
  int here_ = 0;
  std::uint64_t meeting_ = 0;
};

class ThreadComm final : public comm::Comm {
 public:
  ThreadComm(ThreadWorld& world, int rank) : world_(world), rank_(rank) {}
  int rank() const override { return rank_; }
  int size() const override { return world_.ranks(); }
  void all_sum(std::span<std::uint64_t> values) override;
  void all_min(std::span<std::uint64_t> values) override;
  void all_max(std::span<std::uint64_t> values) override;
  void all_gather(std::span<const std::byte> local, Buffer<std::byte>& all, std::vector<std::size_t>& sizes) override;
  void gather(std::span<const std::byte> local, int root, Buffer<std::byte>& all,
              std::vector<std::size_t>& sizes) override;
  void broadcast(std::span<std::byte> bytes, int root) override;
  void exchange(std::span<const std::span<const std::byte>> send,
                std::span<const std::span<std::byte>> receive) override;
  void barrier() override;

 private:
  void enter(const ThreadWorld::Call& call);
  const ThreadWorld::Call& call_of(int rank) const { return world_.calls_[static_cast<std::size_t>(rank)]; }
  template <typename Combine>
  void reduce(const char* name, std::span<std::uint64_t> values, const Combine& combine);
  void collect(Buffer<std::byte>& all, std::vector<std::size_t>& sizes) const;

  ThreadWorld& world_;
  int rank_;
};

// Runs body(rank) on that many threads and waits for them all.
void run_threads(int ranks, const std::function<void(int)>& body);

}  // namespace rcb::testing
