// Room `context`: what every command works with: its order, the ranks, the scenes and common collectives.
//
// Context: the argument of every command handler, and the table of the handlers.
#pragma once

#include <map>
#include <span>
#include <string>
#include <vector>

#include "common/base/clock.hpp"
#include "common/comm/comm.hpp"
#include "server/service/context/order.hpp"
#include "server/service/scene/scene.hpp"

namespace rcb::service {

struct Context {
  comm::Comm& comm;
  const Clock& clock;
  const ServiceOptions& options;
  std::map<std::string, Scene>& scenes;
  SideThread& files;  // on which this rank reads and writes clients' files
  // The slices of the push being executed: all of them on rank 0 or, if the ranks received them directly, each rank's
  // own.
  std::vector<PushSlice> slices;
  OrderTerms terms = {};
  double begun = 0;  // clock time at which the order began

  bool root() const { return comm.rank() == 0; }
  // Collective. Fails once the order's deadline has passed or its client has gone; rank 0 decides for all ranks. Long
  // commands call it between their stages, before they change anything. If the command gives way
  // (server/api/commands.hpp), it also executes the waiting orders of other scenes. Errors: deadline_exceeded, aborted.
  Status check_time();
  // Local. What check_time() finds on rank 0, without giving way.
  Status check_time_here() const;
};

// Collective. Takes its arguments from the request, which is the same on all ranks; changes nothing if it fails.
using Handler = Response (*)(Context&, const wire::Json& request);
using SceneHandler = Response (*)(Context&, Scene&, const wire::Json& request);

// What must be there before a command is run: the scene that its request names, its cuts, or its positions, too.
enum class Needs { scene, cuts, positions };

struct Command {
  constexpr Command(const char* of, Handler handler) : name(of), run(handler) {}
  constexpr Command(const char* of, SceneHandler handler, Needs what, bool passes = false)
      : name(of), run_on(handler), needs(what), computes(passes) {}

  const char* name;
  Handler run = nullptr;  // of a command without a scene; else null
  SceneHandler run_on = nullptr;
  Needs needs = Needs::scene;
  bool computes = false;  // the answer takes a pass over the particles that no step needs
};

// One table for each family of commands; service.cpp joins them.
std::span<const Command> scene_commands();
std::span<const Command> push_commands();
std::span<const Command> query_commands();
std::span<const Command> quality_commands();
std::span<const Command> halo_commands();
std::span<const Command> rebalance_commands();
std::span<const Command> file_commands();

// The scene that the request's field "scene" names, if it has what is needed. Errors: invalid_argument, not_found
// (also: it has no positions yet).
Result<Scene*> find_scene(Context& context, const wire::Json& request, Needs needs);

// Checks the limit on the parts of all scenes together if the scene `changed` gets `parts`. Errors: too_large.
Status check_parts_total(const std::map<std::string, Scene>& scenes, const std::string& changed, int parts);

using api::done;
using api::failed;
using api::make_array;
using scene::read_method;

}  // namespace rcb::service
