// Slice: the particles of a push that go to one rank, as the client sent them, or the memory in which they are.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "common/files/shared_memory.hpp"
#include "common/particles/block_ranges.hpp"
#include "common/wire/message.hpp"
#include "server/api/push.hpp"

namespace rcb::api {

// An array in memory that the client shares with this rank; no memory if the client shares none of that number.
struct SharedColumn {
  SharedArray where;
  std::shared_ptr<const SharedMemory> memory;
};

struct Slice {
  int rank = 0;                          // or kInsertedSlice, kRemovedSlice
  std::uint64_t count = 0;               // from shared memory: of the array "row", if there is one
  std::vector<wire::Array> arrays = {};  // x y z (w) (id), or x y z slot
  particles::BlockRanges ranges = {};    // of the positions, if they were taken as the arrays arrived
  int member = 0;                        // of a parallel solver: the one that sent it
  // Instead of arrays, if the client shares memory:
  std::vector<SharedColumn> shared = {};
  std::uint64_t rows = 0;       // of each array but "row"
  std::uint64_t first_row = 0;  // in the array "row": the first for this rank
  bool is_float32 = false;      // positions
};

}  // namespace rcb::api
