// Room `push`: a push as the socket side sees it, and the interface to the engine (engine.hpp). No sockets here.
//
// Push: what a push says of its rows, and their arrays.
//
// Invariant: every size is checked against limits and the announcement before memory is reserved for it, and memory
// grows with the bytes that arrive: an announcement alone costs nothing.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "common/wire/frame.hpp"
#include "common/wire/message.hpp"
#include "server/api/push.hpp"
#include "server/net/push/engine.hpp"
#include "server/scene/ledger.hpp"

namespace rcb::net {

using api::PushId;
using api::read_push_id;

// A push that was admitted, and what is known of its scene.
struct PushTerms : api::Push {
  int ranks = 1;
  int dims = 3;

  // Of all arrays in memory; at most 2^54.
  std::uint64_t bytes() const { return 8 * n * (static_cast<unsigned>(dims) + (weights ? 1U : 0U) + (ids ? 1U : 0U)); }
};

// Reads a push and checks it against what is known of its scene. seats: that push the scene together. Errors:
// invalid_argument, not_found, stale_step, too_large, unsupported.
Result<PushTerms> read_push_terms(const wire::Json& request, const PushId& id, const scene::SceneState& scene,
                                  int ranks, std::uint64_t bytes_max, std::size_t seats);

// Whether slices for the ranks may follow this push on connections of their own, though it was refused.
bool may_bring_slices(const wire::Json& request);

// A slice of `count` rows with the arrays that the terms require, still without bytes.
// Errors: invalid_argument, protocol_error (the connection must end).
Result<Slice> make_slice(const wire::Json& request, std::uint64_t bulk_bytes, const PushTerms& terms,
                         std::uint64_t count);

// Converts float32 to double, which is exact. `floats` may be the last half of `doubles`.
void widen(std::span<const std::byte> floats, std::span<std::byte> doubles);

}  // namespace rcb::net
