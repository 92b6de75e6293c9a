// Room `push`: a push as the socket side sees it, and the interface to the engine (engine.hpp). No sockets here.
//
// Push: what a push.begin announces, and the slices that must follow it.
//
// Invariants
// 1. Every size is checked against limits and the announcement before memory is reserved for it, and memory grows with
//    the bytes that arrive: an announcement alone costs nothing.
// 2. A push is complete when all announced slices have come and their particles add up to the announced number.
#pragma once

#include <cstdint>
#include <set>
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

using api::Moved;
using api::PlanId;
using api::PushId;
using api::read_plan;
using api::read_push_id;

// A push.begin that was admitted, and what is known of its scene.
struct PushTerms : api::Push {
  int ranks = 1;
  int dims = 3;
  bool scene_weights = false;  // the scene has weights, so inserted particles must have some

  bool last_array() const { return ids || moved == Moved::some; }  // ids or slots, after positions and weights
  std::uint64_t edit_slices() const { return (inserted > 0 ? 1U : 0U) + (removed > 0 ? 1U : 0U); }
  std::uint64_t bytes() const;  // of all arrays in memory; at most 2^55
};

// A client pushes all particles of the scene, a member of a parallel solver only its own.
enum class Pusher { client, member };

// Reads a push.begin of a new step and checks it against what is known of its scene.
// Errors: invalid_argument, base_lost, stale_plan, too_large, unsupported.
Result<PushTerms> read_push_terms(const wire::Json& request, const PushId& id, const scene::SceneState& scene,
                                  int ranks, std::uint64_t bytes_max, Pusher pusher = Pusher::client);

// Whether slices for the ranks may follow this push.begin on connections of their own, though it was refused.
// Refusal of a refill.
Status not_lacking(const PushId& id);

bool may_bring_slices(const wire::Json& request);

// A slice of `count` particles with the arrays that the terms require, still without bytes.
// Errors: invalid_argument, protocol_error (the connection must end).
Result<Slice> make_slice(const wire::Json& request, std::uint64_t bulk_bytes, const PushTerms& terms, int rank,
                         std::uint64_t count);

// Converts float32 to double, which is exact. `floats` may be the last half of `doubles`.
void widen(std::span<const std::byte> floats, std::span<std::byte> doubles);

// The slices of a push that have arrived.
class PushSlices {
 public:
  explicit PushSlices(PushTerms terms) : terms_(std::move(terms)) {}
  const PushTerms& terms() const { return terms_; }

  // The slice that a push.slice announces, its arrays without bytes. Changes nothing. Errors: invalid_argument,
  // protocol_error (the connection must end).
  Result<Slice> begin_slice(const wire::Json& request, std::uint64_t bulk_bytes) const;
  // Adds a slice whose arrays are filled. Errors: invalid_argument (the counts don't add up).
  Status add(Slice slice);
  bool whole() const { return slices_.size() == terms_.slices; }
  std::string progress() const;  // "2 of 4 slices"
  std::vector<Slice> take() { return std::move(slices_); }

 private:
  PushTerms terms_;
  std::vector<Slice> slices_;
  std::set<int> ranks_;
  std::uint64_t count_ = 0;
};

}  // namespace rcb::net
