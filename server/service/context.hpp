// Context: what every command handler gets, and the table that names the handlers.
#pragma once

#include <map>
#include <span>
#include <string>
#include <vector>

#include "common/base/clock.hpp"
#include "common/io/roots.hpp"
#include "common/partition/comm.hpp"
#include "server/service/arrival.hpp"
#include "server/service/no_skip.hpp"
#include "server/service/scene.hpp"
#include "server/service/service.hpp"

namespace rcb::service {

struct Context {
  partition::Comm& comm;
  const Clock& clock;
  std::map<std::string, Scene>& scenes;
  // Of the push being executed: all of them on rank 0, or, where it was staged on the ranks, each rank's own.
  std::vector<PushSlice> slices;
  double received_seconds = 0;
  std::vector<Spare>& spares;
  NoSkip no_skip;
  const io::Roots& roots;            // where files may be read and written
  HistoryRoom& histories;            // of rank 0's scenes
  std::shared_ptr<const Loan> loan;  // what the order's scene had lent until now

  OrderTerms terms = {};
  double begun = 0;  // by the clock

  bool root() const { return comm.rank() == 0; }
  // Whether the order may go on: not after its deadline, nor once its client has gone. For commands that may take
  // long, between their parts, before anything is changed. Orders of other scenes that wait are executed meanwhile,
  // where the command gives way (server/api/commands.hpp). Rank 0's word, the same on all ranks. Collective.
  // Errors: deadline_exceeded, aborted.
  Status check_time();
};

// Collective. Reads its arguments from the request, the same on all ranks; changes nothing if it fails.
using Handler = Response (*)(Context&, const wire::Json& request);

struct Command {
  const char* name;
  Handler run;
  bool computes = false;  // its answer takes a pass over particles that no step needs
};

// One table a command family; service.cpp joins them.
std::span<const Command> scene_commands();
std::span<const Command> push_commands();
std::span<const Command> member_commands();
std::span<const Command> query_commands();
std::span<const Command> paged_commands();
std::span<const Command> quality_commands();
std::span<const Command> rebalance_commands();
std::span<const Command> file_commands();

// The scene that the request's field "scene" names. Errors: invalid_argument, not_found.
Result<Scene*> find_scene(Context& context, const wire::Json& request);
// The same, and it has positions. Errors also: not_found ("no positions yet").
Result<Scene*> find_pushed_scene(Context& context, const wire::Json& request);

// The field "method", or `otherwise` if absent; a scene method that `dims` allows. Errors: invalid_argument.
Result<partition::Method> read_method(const wire::Json& request, int dims, partition::Method otherwise);

// Whether all scenes together may have so many parts, once `changed` has these. Errors: too_large.
Status check_parts_total(const std::map<std::string, Scene>& scenes, const std::string& changed, int parts);

inline Response failed(Status status) { return {std::move(status), wire::Json::object(), {}}; }
inline Response done(wire::Json json) { return {{}, std::move(json), {}}; }

wire::Array make_array(std::string name, std::string dtype, std::uint64_t count, Buffer<std::byte> bytes);

template <typename T>
wire::Array make_array(std::string name, std::string dtype, std::span<const T> values) {
  Buffer<std::byte> bytes;
  bytes.assign(std::as_bytes(values));
  return make_array(std::move(name), std::move(dtype), values.size(), std::move(bytes));
}

}  // namespace rcb::service
