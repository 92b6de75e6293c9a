// Push: what a push says. Read once, for the socket side, which checks it against what is known of the scene
// before it admits the push, and for the ranks, which check it against the scene itself.
#pragma once

#include <algorithm>
#include <compare>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "common/wire/field_reader.hpp"
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

// session: that of the connection. Errors: invalid_argument.
Result<PushId> read_push_id(const wire::Json& request, std::string session);

// Names the cuts of a scene; all 0: none.
struct CutsId {
  std::uint64_t epoch = 0;
  std::uint64_t hash = 0;
  bool operator==(const CutsId&) const = default;
};

// Where an array of a block lies in memory that the client shares with the ranks.
struct SharedArray {
  std::string name;          // x (y, z), w, id, or row
  std::int64_t memory = 0;   // number of the memory, chosen by the client
  std::uint64_t offset = 0;  // of the first row's element; like `stride` in bytes, a multiple of the element's size
  std::uint64_t stride = 0;  // from one row to the next
};
// Reads the field "memory". Errors: invalid_argument.
Result<std::vector<SharedArray>> read_shared(const wire::Json& request);

using scene::Way;

// A block: the rows that one client, or one seat of a scene, has in a step.
struct Push {
  PushId id;
  std::uint64_t n = 0;
  Way way = Way::endpoint;
  std::vector<SharedArray> shared;    // by shared memory
  std::vector<int> by_socket;         // by shared memory: the ranks, ascending, that get their rows over sockets
  std::vector<std::uint64_t> counts;  // by rank, where the client says which rows are whose; else empty
  bool weights = false;
  bool ids = false;
  bool is_float32 = false;                   // positions, as sent
  std::uint64_t inserted = 0;                // of the rows: particles that were not there before the step
  std::uint64_t removed = 0;                 // particles that are no more
  std::optional<double> step_seconds;        // the solver's computing time since its last push
  std::optional<std::uint64_t> incarnation;  // of the scene that is meant
  std::optional<std::uint64_t> drifted;      // since the step before, as the client has counted
  std::optional<CutsId> cuts_known;  // that the client has: the answer is to bring those after the step if they differ

  bool flows() const { return inserted > 0 || removed > 0; }
  bool to_ranks() const { return way != Way::endpoint; }  // no positions come through the endpoint
  bool from_memory() const { return way == Way::shared_memory; }
  bool from_memory(int rank) const { return from_memory() && !std::ranges::binary_search(by_socket, rank); }
  // From memory, and nothing says which rows are whose: each rank reads those of the particles that it holds.
  bool by_held() const { return from_memory() && counts.empty(); }
  // Whether ranks, or this one, receive rows over sockets of their own.
  bool direct() const { return way == Way::sockets || !by_socket.empty(); }
  bool direct(int rank) const { return direct() && !from_memory(rank); }
};

// How the rows of a block come.
Way read_way(wire::FieldReader& fields);

// The fields of a push besides those of `id`. Errors: invalid_argument.
Result<Push> read_push(const wire::Json& request, PushId id, int ranks);

}  // namespace rcb::api
