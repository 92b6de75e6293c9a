// Every rank's words on every rank, as a collective made of Comm's.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/partition/comm.hpp"

namespace rcb::partition {

struct GatheredWords {
  std::vector<std::uint64_t> words;  // in rank order
  std::vector<std::size_t> counts;   // each rank's
};

// Collective.
GatheredWords gather_words(Comm& comm, std::span<const std::uint64_t> mine);

}  // namespace rcb::partition
