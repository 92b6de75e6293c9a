// SelfComm: every collective is a copy.
#include "tests/support/self_comm.hpp"

#include <cstring>

#include "common/base/check.hpp"

namespace rcb::testing {
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
  RCB_CHECK(root == 0, "the only rank");
  exchange(pieces, {&mine, 1});
}

void SelfComm::exchange(std::span<const std::span<const std::byte>> send,
                        std::span<const std::span<std::byte>> receive) {
  RCB_CHECK(send.size() == 1 && receive.size() == 1, "the only rank");
  RCB_CHECK(send[0].size() == receive[0].size(), "both sides know the size");
  if (!send[0].empty()) std::memmove(receive[0].data(), send[0].data(), send[0].size());
}

}  // namespace rcb::testing
