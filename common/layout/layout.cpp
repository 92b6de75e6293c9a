#include "common/layout/layout.hpp"

#include "common/base/wide.hpp"
#include "common/cuts/halo.hpp"

namespace rcb::layout {

std::int64_t part_begin(int rank, int parts, int ranks) { return static_cast<std::int64_t>(rank) * parts / ranks; }

PartRange parts_of_rank(int rank, int parts, int ranks) {
  return {static_cast<int>(part_begin(rank, parts, ranks)), static_cast<int>(part_begin(rank + 1, parts, ranks))};
}

int rank_of_part(int part, int parts, int ranks) { return cuts::seat_of_part(part, parts, ranks); }

std::uint64_t row_begin(int rank, std::uint64_t count, int ranks) {
  return static_cast<std::uint64_t>(static_cast<u128>(static_cast<unsigned>(rank)) * count /
                                    static_cast<unsigned>(ranks));
}

}  // namespace rcb::layout
