// Exchange: moves the particles whose part another rank owns to that rank.
//
// Invariants
// 1. Every particle travels once, straight to the rank that owns its part: array after array if there are many, in one
//    exchange if there are few.
// 2. After a full change a rank holds its particles in ascending id. After another one those that stay keep their
//    slots; the others fill what is free.
// 3. Memory of a rank for a full change, besides its particles (before or after it, whichever are more): 16 bytes for
//    each of them, 8 for each arriving and 8 for each leaving particle; and ExchangeLimits::round_bytes for what is
//    being sent. The given list of exports is freed first.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "server/service/context/context.hpp"

namespace rcb::service {

struct ExchangeLimits {
  std::uint64_t few = 100'000;                          // up to this many exports in all go in one exchange
  std::uint64_t round_bytes = std::uint64_t{8} << 20U;  // otherwise: bytes that a rank sends in one round
};

// Whether so many change rank that all ranks go back to ascending id.
inline bool is_full_change(std::uint64_t changed, std::uint64_t count) { return changed > count / 16; }

// Sends each local particle whose part another rank owns. scene.part has the new parts, scene.options.parts their
// number. Returns on every rank how many have gone in all. first: a full change, however few they are. Collective.
std::uint64_t send_strangers(comm::Comm& comm, Scene& scene, bool first, const ExchangeLimits& limits = {});

// The same where these are such. changed: of all ranks, above 0; from_to: [from][to] how many, or empty. Collective.
void send_exports(comm::Comm& comm, Scene& scene, std::vector<std::uint64_t> slots, std::uint64_t changed,
                  std::span<const std::uint64_t> from_to);

}  // namespace rcb::service
