// Blocks: reads the rows that the blocks of a step bring to this rank, however they come: over the rank's own socket,
// out of memory that a client shares, or through the endpoint to rank 0, which deals them out.
#pragma once

#include <cstdint>
#include <vector>

#include "common/base/status.hpp"
#include "common/particles/particle_set.hpp"
#include "server/service/context/context.hpp"
#include "server/service/push/request.hpp"

namespace rcb::service {

// Rows of one seat that follow one another on this rank.
struct Run {
  int seat = 0;
  std::uint64_t begin = 0;  // among this rank's rows
  std::uint64_t count = 0;
};

struct Arrived {
  particles::ParticleSet set;  // with ids
  std::vector<Run> runs;       // by ascending seat
  bool took_slice = false;     // its memory is that of a slice
};

// Weights and ids as the push says; without ids a row's number is its id. Takes spare
// memory, and keeps that of the slices as such or uses it. Nothing of the scene changes. Collective. Errors: aborted,
// invalid_argument, too_large, the same on every rank.
Result<Arrived> read_blocks(Context& context, Scene& scene, const PushRequest& push);

}  // namespace rcb::service
