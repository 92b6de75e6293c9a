// SelfComm: the Comm of a single rank.
#pragma once

#include "common/comm/comm.hpp"

namespace rcb::testing {

class SelfComm final : public comm::Comm {
 public:
  int rank() const override { return 0; }
  int size() const override { return 1; }
  void all_sum(std::span<std::uint64_t>) override {}
  void all_min(std::span<std::uint64_t>) override {}
  void all_max(std::span<std::uint64_t>) override {}
  void all_gather(std::span<const std::byte> local, Buffer<std::byte>& all, std::vector<std::size_t>& sizes) override;
  void gather(std::span<const std::byte> local, int root, Buffer<std::byte>& all,
              std::vector<std::size_t>& sizes) override;
  void broadcast(std::span<std::byte>, int) override {}
  void scatter(std::span<const std::span<const std::byte>> pieces, int root, std::span<std::byte> mine) override;
  void exchange(std::span<const std::span<const std::byte>> send,
                std::span<const std::span<std::byte>> receive) override;
  void barrier() override {}
};

}  // namespace rcb::testing
