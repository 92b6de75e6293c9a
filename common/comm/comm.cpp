// The collectives that are built on Comm's methods.
#include "common/comm/comm.hpp"

#include <algorithm>

#include "common/base/check.hpp"

namespace rcb::comm {

void Comm::all_gather_few(std::span<const std::byte> local, Buffer<std::byte>& all) {
  std::vector<std::size_t> sizes;
  all_gather(local, all, sizes);
}

std::uint64_t all_min_in_messages(Comm& comm, std::span<std::uint64_t> values) {
  std::uint64_t messages = 0;
  for (; !values.empty(); ++messages) {
    const std::size_t count = std::min(kMessageWordsMax, values.size());
    comm.all_min(values.first(count));
    values = values.subspan(count);
  }
  return messages;
}

void exchange_counts(Comm& comm, std::span<const std::uint64_t> to, std::span<std::uint64_t> from) {
  const auto ranks = static_cast<std::size_t>(comm.size());
  RCB_CHECK(to.size() == ranks && from.size() == ranks, "one count a rank");
  std::vector<std::span<const std::byte>> send(ranks);
  std::vector<std::span<std::byte>> receive(ranks);
  for (std::size_t r = 0; r < ranks; ++r) {
    send[r] = std::as_bytes(to.subspan(r, 1));
    receive[r] = std::as_writable_bytes(from.subspan(r, 1));
  }
  comm.exchange(send, receive);
}

bool agree(Comm& comm, bool here) {
  std::uint64_t verdict = here ? 1 : 0;
  comm.all_min({&verdict, 1});
  return verdict == 1;
}

}  // namespace rcb::comm
