// Slice: rows of a block as a rank gets them: the arrays that a client has sent, or the memory in which they are.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "common/files/shared_memory.hpp"
#include "common/wire/message.hpp"
#include "server/api/push.hpp"

namespace rcb::api {

// An array in memory that the client shares with this rank; no memory if the client shares none of that number.
struct SharedColumn {
  SharedArray where;
  std::shared_ptr<const SharedMemory> memory;
};

struct Slice {
  int seat = 0;                          // of a parallel solver: the one that sent it
  std::uint64_t count = 0;               // from shared memory: of the array "row", if there is one
  std::vector<wire::Array> arrays = {};  // x y z (w) (id)
  std::uint64_t first_row = 0;           // number of the first of these rows in the block
  // Instead of arrays, if the client shares memory:
  std::vector<SharedColumn> shared = {};
  std::uint64_t rows = 0;   // of each array but "row"
  bool is_float32 = false;  // positions
};

}  // namespace rcb::api
