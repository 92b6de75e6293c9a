// Room `layout`: which rank owns which parts, and is dealt which rows. The rules are part of the protocol.
#pragma once

#include <cstdint>

namespace rcb::layout {

// The parts that rank r of `ranks` owns: [part_begin(r), part_begin(r + 1)). The same rule gives each seat of a scene
// its parts.
std::int64_t part_begin(int rank, int parts, int ranks);
struct PartRange {
  int begin = 0;
  int end = 0;

  bool has(int part) const { return part >= begin && part < end; }
};
PartRange parts_of_rank(int rank, int parts, int ranks);
int rank_of_part(int part, int parts, int ranks);
// The rows of rank r where rows are divided evenly: [row_begin(r), row_begin(r + 1)).
std::uint64_t row_begin(int rank, std::uint64_t count, int ranks);

}  // namespace rcb::layout
