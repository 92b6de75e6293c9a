// Push: what a push.begin announces, and the slices that must follow it.
//
// Invariants
// 1. Every size is bounded by what was announced and checked before memory is made for it, and memory grows with
//    what arrives: an announcement alone costs nothing.
// 2. A push is whole when its announced slices are there and their counts add up to what was announced.
#pragma once

#include <compare>
#include <cstdint>
#include <set>
#include <span>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "common/wire/frame.hpp"
#include "common/wire/message.hpp"
#include "server/net/engine.hpp"

namespace rcb::net {

// Names one attempt at one step.
struct PushId {
  std::string scene;
  std::string session;
  std::int64_t step = 0;
  std::int64_t attempt = 0;
  auto operator<=>(const PushId&) const = default;
};

// `session` where the message names none. Errors: invalid_argument.
Result<PushId> read_push_id(const wire::Json& request, const std::string& session);

struct PlanId {
  std::uint64_t version = 0;
  std::uint64_t checksum = 0;
  bool operator==(const PlanId&) const = default;
};

// The field "plan". Errors: invalid_argument.
Result<PlanId> read_plan(const wire::Json& request);

// Whose positions a push brings.
enum class Moved { all, some, none };

struct PushTerms {
  PushId id;
  PlanId plan;  // as the client says; of the direct path alone
  std::uint64_t n = 0;
  std::uint64_t slices = 0;
  int ranks = 1;
  int dims = 3;
  bool by_id = false;
  bool weights = false;
  bool ids = false;
  bool direct = false;  // the slices go to the ranks themselves
  Moved moved = Moved::all;
  bool single = false;       // positions come as float32
  std::uint64_t moving = 0;  // particles whose positions come
  // Of each rank, where few moved or a member pushes directly; order "id": of the one slice.
  std::vector<std::uint64_t> counts;
  std::uint64_t inserted = 0;
  std::uint64_t removed = 0;
  bool inserted_ids = false;   // the solver's own
  bool scene_weights = false;  // hence of the inserted

  bool last_array() const { return ids || moved == Moved::some; }  // ids or slots, behind the positions and weights
  std::uint64_t edit_slices() const { return (inserted > 0 ? 1U : 0U) + (removed > 0 ? 1U : 0U); }
  std::uint64_t bytes() const;  // of all arrays in memory; at most 2^55
};

// Who pushes: one client all particles, or a member of a parallel solver its own.
enum class Pusher { client, member };

// Reads a push.begin and holds it against what is known of its scene. A step that isn't above the scene's last is let
// through: it may be one that is committed already, and only the service knows its report.
// Errors: invalid_argument, base_lost, stale_plan, too_large, unsupported.
Result<PushTerms> read_push_terms(const wire::Json& request, const PushId& id, const api::SceneSummary& scene,
                                  int ranks, std::uint64_t bytes_max, Pusher pusher = Pusher::client);

// A slice of `count` particles whose arrays, still without bytes, are those that the terms demand.
// Errors: invalid_argument, protocol_error (the connection must end).
Result<Slice> make_slice(const wire::Json& request, std::uint64_t bulk_bytes, const PushTerms& terms, int rank,
                         std::uint64_t count);

// float32 values become as many doubles. Exact. They may be the last half of `doubles`.
void widen(std::span<const std::byte> floats, std::span<std::byte> doubles);

// What has come of a push.
class PushSlices {
 public:
  explicit PushSlices(PushTerms terms) : terms_(std::move(terms)) {}
  const PushTerms& terms() const { return terms_; }

  // The slice that this push.slice announces, its arrays without bytes. Errors: invalid_argument, protocol_error (the
  // connection must end). Nothing is changed.
  Result<Slice> begin_slice(const wire::Json& request, std::uint64_t bulk_bytes) const;
  // Takes a slice whose arrays are filled. Errors: invalid_argument (the counts don't add up).
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
