// Exchange: moves the particles that change their rank to their new ranks, and updates the layout.
//
// Invariants
// 1. Every particle travels once, straight to the rank that owns its part: array after array if there are many, in one
//    exchange if there are few.
// 2. Memory of a rank for a full change, besides its particles (before or after it, whichever are more): 12 bytes for
//    each of them, 8 for each arriving and 4 for each leaving particle, if slots fit in 32 bits; and
//    ExchangeLimits::round_bytes for what is being sent. The given list of exports is freed first.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/layout/layout.hpp"
#include "server/service/context/context.hpp"

namespace rcb::service {

// Exports: the local particles whose part another rank owns.
struct Exports {
  std::vector<std::uint64_t> counts;  // by destination rank
  std::vector<std::uint64_t> slots;   // ascending
};

// Fills in exports.counts from exports.slots. Local.
void count_by_rank(const comm::Comm& comm, const Scene& scene, Exports& exports);

struct Arrivals {
  particles::ParticleSet particles;
  Buffer<std::int32_t> part;
};

struct ExchangeLimits {
  std::uint64_t few = 100'000;                           // up to this many exports in all go in one exchange
  std::uint64_t round_bytes = std::uint64_t{8} << 20U;   // otherwise: bytes that a rank sends in one round
  std::uint64_t narrow_slots = std::uint64_t{1} << 32U;  // with at most this many slots, 32-bit slot numbers are used
};

// Exchanges the exports and updates the layout. Collective.
//   from     by rank: number of particles that arrive from it
//   changed  number of exports, all ranks together
//   full     a full change (ascending ids on every rank): layout::is_full_change(), or the first partition
void exchange_particles(comm::Comm& comm, Scene& scene, Exports exports, std::span<const std::uint64_t> from,
                        std::uint64_t changed, bool full, const ExchangeLimits& limits = {});

// A small change: arrivals fill free slots, the other particles keep theirs. Returns the change of the layout's
// checksum. Local.
std::uint64_t fill_holes(Scene& scene, int rank, const Exports& exports, Arrivals& arrivals,
                         const layout::SlotEdit& edit);

}  // namespace rcb::service
