// SelfComm: every collective is a copy.
#include "common/comm/self_comm.hpp"

#include <cstring>

#include "common/base/check.hpp"

namespace rcb::comm {
namespace {

void copy(std::span<const std::byte> from, std::span<std::byte> to) {
  RCB_CHECK(from.size() == to.size(), "both sides know the size");
  if (!from.empty()) std::memmove(to.data(), from.data(), from.size());
}

}  // namespace

void SelfComm::all_gather(std::span<const std::byte> local, Buffer<std::byte>& all, std::vector<std::size_t>& sizes) {
  all.assign(local);
  sizes.assign(1, local.size());
}

void SelfComm::gather(std::span<const std::byte> local, int root, Buffer<std::byte>& all,
                      std::vector<std::size_t>& sizes) {
  RCB_CHECK(root == 0, "the only rank");
  all_gather(local, all, sizes);
}

void SelfComm::scatter(std::span<const std::span<const std::byte>> pieces, int root, std::span<std::byte> mine) {
  RCB_CHECK(root == 0 && pieces.size() == 1, "the only rank");
  copy(pieces[0], mine);
}

void SelfComm::exchange(std::span<const std::span<const std::byte>> send,
                        std::span<const std::span<std::byte>> receive) {
  RCB_CHECK(send.size() == 1 && receive.size() == 1, "the only rank");
  copy(send[0], receive[0]);
}

}  // namespace rcb::comm
