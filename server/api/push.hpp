// Push: what a push.begin says. Read once, for the socket side, which checks it against what is known of the scene
// before it admits the push, and for the ranks, which check it against the scene itself.
#pragma once

#include <algorithm>
#include <compare>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "common/wire/message.hpp"
#include "server/scene/report.hpp"

namespace rcb::api {

// Identifies one attempt to push one step.
struct PushId {
  std::string scene;
  std::string session;
  std::int64_t step = 0;
  std::int64_t attempt = 0;
  auto operator<=>(const PushId&) const = default;
};

// `session` is used if the message names none. Errors: invalid_argument.
Result<PushId> read_push_id(const wire::Json& request, const std::string& session);

struct PlanId {
  std::uint64_t version = 0;
  std::uint64_t checksum = 0;
  bool operator==(const PlanId&) const = default;
};

// Reads the field "plan". Errors: invalid_argument.
Result<PlanId> read_plan(const wire::Json& request);

// Names the cuts of a scene; all 0: none.
struct CutsId {
  std::uint64_t epoch = 0;
  std::uint64_t hash = 0;
  bool operator==(const CutsId&) const = default;
};

// Of which particles a push brings positions.
enum class Moved { all, some, none };
const char* name_of(Moved moved);  // as in the field "moved"

// Where an array of a push lies in memory that the client shares with the ranks.
struct SharedArray {
  std::string name;          // x (y, z), w, id, or row
  std::int64_t memory = 0;   // number of the memory, chosen by the client
  std::uint64_t offset = 0;  // of the first row's element; like `stride` in bytes, a multiple of the element's size
  std::uint64_t stride = 0;  // from one row to the next
};
// Reads the field "memory". Errors: invalid_argument.
Result<std::vector<SharedArray>> read_shared(const wire::Json& request);

using scene::Way;

struct Push {
  PushId id;
  PlanId plan;  // the layout by which the client sorted its slices; order "plan" only
  std::uint64_t n = 0;
  std::uint64_t slices = 0;
  bool by_id = false;  // order "id": one slice with all particles; else one for each rank, in the layout's order
  Way way = Way::endpoint;
  std::vector<SharedArray> shared;  // by shared memory, instead of slices
  std::vector<int> by_socket;  // by shared memory: the ranks, ascending, whose slices come over sockets all the same
  bool weights = false;
  bool ids = false;
  // No step, but the particles of the last one, at any positions: for ranks that hold none, since they were started
  // again.
  bool refill = false;
  bool changes = false;     // the answer is to name the particles that changed their part
  bool is_float32 = false;  // of the positions, as sent
  Moved moved = Moved::all;
  // Particles in each rank's slice, or in order "id" in the one slice; if only some moved, or where a member takes the
  // direct path.
  std::vector<std::uint64_t> counts;
  std::uint64_t inserted = 0;
  std::uint64_t removed = 0;
  bool inserted_ids = false;              // the solver chose the ids of the inserted particles
  std::optional<std::int64_t> base_step;  // the step of the other particles' positions
  std::optional<double> step_seconds;     // the solver's computing time since its last push
  std::optional<std::uint64_t> drifted;   // since the step before, as the client has counted
  std::optional<CutsId> cuts_known;  // that the client has: the answer is to bring those after the step if they differ

  bool to_ranks() const { return way != Way::endpoint; }  // no positions come through the endpoint
  bool from_memory() const { return way == Way::shared_memory; }
  bool from_memory(int rank) const { return from_memory() && !std::ranges::binary_search(by_socket, rank); }
  // Whether ranks, or this one, receive slices over sockets of their own.
  bool direct() const { return way == Way::sockets || !by_socket.empty(); }
  bool direct(int rank) const { return direct() && !from_memory(rank); }
  bool edits() const { return inserted > 0 || removed > 0; }
  std::uint64_t moving() const;  // particles whose positions are sent
};

// The fields of a push.begin besides those of `id`. Errors: invalid_argument.
Result<Push> read_push(const wire::Json& request, PushId id, int ranks);

}  // namespace rcb::api
