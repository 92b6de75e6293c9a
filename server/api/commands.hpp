// Commands: what the service knows of each command before it runs one, in one table.
//
// The sessions ask it who runs a command, the engine whether a command may change a scene. A request is cut down to the
// fields named here before anyone reads it, so a field of the inside (a push's "staged") can't come from a client.
#pragma once

#include <span>
#include <string_view>

#include "common/wire/message.hpp"

namespace rcb::api {

enum class RunsOn {
  session,  // the I/O thread answers it
  root,     // rank 0's engine alone: all that it needs is the same on every rank
  ranks,    // every rank's engine: it is collective, or changes what all ranks hold
};

enum class Effect { reads, changes };

struct CommandInfo {
  std::string_view name;
  RunsOn runs_on;
  Effect effect;                             // on scenes
  std::span<const std::string_view> fields;  // besides "command" and "deadline_seconds"
  bool files = false;                        // has the ranks read or write files
  bool gives_way = false;                    // may last for seconds; orders of other scenes go on meanwhile

  bool reads() const { return effect == Effect::reads; }
};

std::span<const CommandInfo> commands();
// Null if there is none of this name.
const CommandInfo* find_command(std::string_view name);

// Drops every field that the command doesn't have.
void keep_known_fields(wire::Json& request, const CommandInfo& command);

// Whether this request changes a scene: its command does, and it isn't a dry run.
bool changes_scene(const wire::Json& request, const CommandInfo& command);

}  // namespace rcb::api
