// Room `push`: turns the blocks of a step into checked particles. A failure here changes nothing.
//
// Prepare: reads the blocks, finds the part of every row under the cuts in force, and checks all of it. The particles
// are kept beside the scene's, not yet in the scene.
#pragma once

#include <cstdint>
#include <vector>

#include "server/service/context/context.hpp"
#include "server/service/push/blocks.hpp"
#include "server/service/push/request.hpp"
#include "server/service/push/scan.hpp"

namespace rcb::service {

// Sums over all ranks.
struct StepSums {
  static constexpr int kPartsMax = 1024;  // with more parts, counts aren't part of this reduction
  static constexpr int kRanksMax = 16;    // with more ranks, from_to isn't part of this reduction

  std::uint64_t faults = 0;            // ranks with a fault
  std::uint64_t rows = 0;              // read
  std::uint64_t drifted = 0;           // particles that left the part in which the ranks held them
  std::uint64_t strangers = 0;         // rows outside their seat's parts
  std::uint64_t id_sum = 0;            // of a new set: of mix64(id), or mix64(id + key) where that is compared
  std::uint64_t exported = 0;          // particles whose part another rank owns
  std::vector<std::uint64_t> from_to;  // [from][to]: of these; empty above kRanksMax
  // By part: how many particles a new set has, or else by how many there are more, mod 2^64; empty above kPartsMax,
  // with weights and without cuts.
  std::vector<std::uint64_t> counts;
};

struct Staged {
  std::uint64_t n = 0;
  bool ids = false;   // they aren't 0..n-1
  bool held = false;  // `arrays` are new values of the particles that the rank holds; else a new set of them
  bool same = false;  // of the very particles of the last step, as is known by the scene's key
  particles::ParticleSet arrays;       // this rank's; of held particles without ids, weights only if sent
  Buffer<std::int32_t> part;           // of a new set, under the cuts in force; empty without cuts
  Scan scan;                           // of held particles
  std::vector<std::uint64_t> exports;  // slots, ascending, of particles whose part another rank owns
  StepSums sums;
  std::uint64_t bytes = 0;  // of all arrays, as received
  double seconds = 0;       // time to receive and stage
  bool took_slice = false;  // the arrays are those that the listener received

  // The ranges of the blocks' positions; nullptr if they aren't known.
  const particles::BlockRanges* ranges() const { return scan.ranges.known() ? &scan.ranges : nullptr; }
};

// Collective. Leaves the scene as it was, except for what it caches (regions). Errors: faults of the
// push, the same on every rank: those of read_blocks(), not_finite, invalid_argument,
// not_conserved, duplicate_id, too_large.
Result<Staged> prepare(Context& context, Scene& scene, const PushRequest& push);
// The same where the rows are there already, as a new set of particles. Errors: but for those of read_blocks().
Result<Staged> prepare_set(comm::Comm& comm, Scene& scene, const PushRequest& push, Arrived arrived);

// Keeps the memory that the commit swapped out for the next push, unless rows also lay in other memory before they came
// here. Local.
void give_back(Context& context, const Scene& scene, Staged& staged, api::Way way);

}  // namespace rcb::service
