// Commands: a table of what sessions and engines must know of a command to bring it to its handler. What the handlers
// themselves need is said beside them (server/service/commands).
//
// The sessions look up who runs a command, the engine whether it may change a scene. A client's request is reduced to
// the fields listed here, so it can't set a field for internal use (such as a push's "blocks").
#pragma once

#include <span>
#include <string_view>

#include "common/wire/message.hpp"

namespace rcb::api {

enum class RunsOn {
  session,  // the I/O thread answers it
  ledger,   // likewise, from what rank 0 knows of the scene (server/scene)
  root,     // rank 0's engine alone: the answer needs only what is the same on every rank
  ranks,    // every rank's engine: the command is collective, or changes what all ranks hold
};

enum class Effect { reads, changes };

struct CommandInfo {
  std::string_view name;
  RunsOn runs_on;
  Effect effect;                             // on scenes
  std::span<const std::string_view> fields;  // besides "command" and "deadline_seconds"
  bool files = false;                        // the ranks read or write files
  bool gives_way = false;                    // may take seconds; orders of other scenes are executed meanwhile
  bool large = false;                        // its request's JSON may have wire::kLargeRequest bytes and more

  bool reads() const { return effect == Effect::reads; }
};

std::span<const CommandInfo> commands();
// nullptr if there is no command of this name.
const CommandInfo* find_command(std::string_view name);

// Removes the fields that the command does not have, and those that are null, which count as absent.
void keep_known_fields(wire::Json& request, const CommandInfo& command);

// True if the request changes a scene: its command may, and it isn't a dry run.
bool changes_scene(const wire::Json& request, const CommandInfo& command);

}  // namespace rcb::api
