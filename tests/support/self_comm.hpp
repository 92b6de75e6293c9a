// SelfComm: the Comm of a single rank. Every collective is a copy.
#pragma once

#include <cstring>

#include "common/base/check.hpp"
#include "common/comm/comm.hpp"

namespace rcb::testing {

class SelfComm final : public comm::Comm {
 public:
  int rank() const override { return 0; }
  int size() const override { return 1; }
  void all_sum(std::span<std::uint64_t>) override {}
  void all_min(std::span<std::uint64_t>) override {}
  void all_max(std::span<std::uint64_t>) override {}
  void all_gather(std::span<const std::byte> local, Buffer<std::byte>& all, std::vector<std::size_t>& sizes) override {
    all.assign(local);
    sizes.assign(1, local.size());
  }
  void gather(std::span<const std::byte> local, int root, Buffer<std::byte>& all,
              std::vector<std::size_t>& sizes) override {
    RCB_CHECK(root == 0, "the only rank");
    all_gather(local, all, sizes);
  }
  void broadcast(std::span<std::byte>, int) override {}
  void exchange(std::span<const std::span<const std::byte>> send,
                std::span<const std::span<std::byte>> receive) override {
    RCB_CHECK(send.size() == 1 && receive.size() == 1, "the only rank");
    RCB_CHECK(send[0].size() == receive[0].size(), "both sides know the size");
    if (!send[0].empty()) std::memmove(receive[0].data(), send[0].data(), send[0].size());
  }
  void barrier() override {}
};

}  // namespace rcb::testing
