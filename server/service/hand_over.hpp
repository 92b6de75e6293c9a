// Hand-over: the particles that change their rank, out of the arrays of one into those of another, and the plan in
// step.
//
// Invariants
// 1. Every particle travels once, straight to the rank that owns its part, array after array; few go all at once.
// 2. A full change takes, on every rank and beyond its particles (those before or those after, whichever are more): 12
//    bytes for each of these, 8 for one that arrives and 4 for one that leaves, where slots fit in 32 bits; and
//    HandOverLimits::round_bytes for what is being sent. The list of leavers that it is given goes first.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/plan/plan.hpp"
#include "server/service/context.hpp"

namespace rcb::service {

// The local particles whose part another rank owns.
struct Leavers {
  std::vector<std::uint64_t> counts;  // by rank
  std::vector<std::uint64_t> slots;   // ascending
};

// Fills in the counts. Local.
void count_by_rank(const partition::Comm& comm, const Scene& scene, Leavers& leavers);

struct Arrivals {
  particles::ParticleSet particles;
  Buffer<std::int32_t> part;
};

struct HandOverLimits {
  std::uint64_t few = 100'000;                           // so many changes of all ranks go in one exchange
  std::uint64_t round_bytes = std::uint64_t{8} << 20U;   // that a rank sends in an exchange, of more
  std::uint64_t narrow_slots = std::uint64_t{1} << 32U;  // of slots below this 32 bits are kept
};

// The particles change places, and the plan with them; plan::is_full_change says which way, but a first partition is
// always a full change. Collective.
//   from     by rank: how many particles arrive from it
//   changed  on all ranks together
void hand_over(partition::Comm& comm, Scene& scene, Leavers leavers, std::span<const std::uint64_t> from,
               std::uint64_t changed, bool full, const HandOverLimits& limits = {});

// A small change: free slots are filled, the rest stays where it is. Returns what the plan's checksum gains. Local.
std::uint64_t fill_holes(Scene& scene, int rank, const Leavers& leavers, Arrivals& arrivals,
                         const plan::RankEdit& edit);

}  // namespace rcb::service
