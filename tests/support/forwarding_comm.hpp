// A Comm that passes everything on to another one, for tests that look at what passes.
#pragma once

#include <vector>

#include "common/comm/comm.hpp"

namespace rcb::testing {

// before() is called ahead of every collective, on every rank.
class ForwardingComm : public comm::Comm {
 public:
  explicit ForwardingComm(comm::Comm& comm) : comm_(comm) {}
  int rank() const override { return comm_.rank(); }
  int size() const override { return comm_.size(); }
  void all_sum(std::span<std::uint64_t> values) override { before(), comm_.all_sum(values); }
  void all_min(std::span<std::uint64_t> values) override { before(), comm_.all_min(values); }
  void all_max(std::span<std::uint64_t> values) override { before(), comm_.all_max(values); }
  void all_gather(std::span<const std::byte> local, Buffer<std::byte>& all, std::vector<std::size_t>& sizes) override {
    before(), comm_.all_gather(local, all, sizes);
  }
  void gather(std::span<const std::byte> local, int root, Buffer<std::byte>& all,
              std::vector<std::size_t>& sizes) override {
    before(), comm_.gather(local, root, all, sizes);
  }
  void broadcast(std::span<std::byte> bytes, int root) override { before(), comm_.broadcast(bytes, root); }
  void exchange(std::span<const std::span<const std::byte>> send,
                std::span<const std::span<std::byte>> receive) override {
    before(), comm_.exchange(send, receive);
  }
  void barrier() override { before(), comm_.barrier(); }

 protected:
  virtual void before() {}

  comm::Comm& comm_;
};

}  // namespace rcb::testing
