#include "common/partition/gather_words.hpp"

#include <cstring>

namespace rcb::partition {

GatheredWords gather_words(Comm& comm, std::span<const std::uint64_t> mine) {
  GatheredWords gathered;
  std::vector<std::byte> bytes;
  comm.all_gather(std::as_bytes(mine), bytes, gathered.counts);
  gathered.words.resize(bytes.size() / sizeof(std::uint64_t));
  if (!bytes.empty()) std::memcpy(gathered.words.data(), bytes.data(), bytes.size());
  for (std::size_t& count : gathered.counts) count /= sizeof(std::uint64_t);
  return gathered;
}

}  // namespace rcb::partition
