#include "server/api/commands.hpp"

#include <algorithm>
#include <array>

namespace rcb::api {
namespace {

using enum RunsOn;
using enum Effect;
using Fields = std::string_view;

constexpr std::array<Fields, 1> kScene{"scene"};
constexpr std::array<Fields, 12> kCreate{"scene",      "parts",           "dims",          "method",
                                         "tolerance",  "axis_hysteresis", "cut_tolerance", "policy",
                                         "part_sizes", "replace",         "positions"};
constexpr std::array<Fields, 4> kOpen{"scene", "seat", "seats", "generation"};
constexpr std::array<Fields, 18> kPush{"scene",   "step",         "attempt",    "n",       "way",         "dtype",
                                       "weights", "ids",          "counts",     "memory",  "sockets",     "inserted",
                                       "removed", "step_seconds", "cuts_known", "drifted", "incarnation", "arrays"};
constexpr std::array<Fields, 3> kCount{"scene", "step", "fault"};
constexpr std::array<Fields, 4> kCuts{"scene", "list", "from", "count"};
constexpr std::array<Fields, 4> kHistory{"scene", "last", "from", "count"};
constexpr std::array<Fields, 3> kOwner{"scene", "position", "id"};
constexpr std::array<Fields, 4> kBox{"scene", "lo", "hi", "periodic"};
constexpr std::array<Fields, 3> kAssign{"scene", "checksum", "held"};
constexpr std::array<Fields, 2> kFetch{"scene", "held"};
constexpr std::array<Fields, 3> kQuality{"scene", "ghost_width", "held"};
constexpr std::array<Fields, 4> kNeighbours{"scene", "width", "norm", "periodic"};
constexpr std::array<Fields, 6> kHalo{"scene", "width", "norm", "periodic", "lists", "held"};
constexpr std::array<Fields, 5> kCompare{"scene", "parts", "ghost_width", "methods", "held"};
constexpr std::array<Fields, 7> kRebalance{"scene", "method", "parts", "tolerance", "dry_run", "force", "held"};
constexpr std::array<Fields, 7> kLoad{"scene", "path", "step", "dims", "weights", "columns", "ids"};
constexpr std::array<Fields, 4> kWriteParts{"scene", "directory", "prefix", "held"};

constexpr bool kFiles = true;
constexpr bool kGivesWay = true;
constexpr bool kLarge = true;

constexpr std::array kCommands{
    CommandInfo{"status", session, reads, {}},
    CommandInfo{"shutdown", session, changes, {}},
    CommandInfo{"scene.list", session, reads, {}},
    CommandInfo{"scene.close", session, reads, kScene},
    CommandInfo{"scene.open", ledger, reads, kOpen},
    CommandInfo{"scene.show", ledger, reads, kScene},
    CommandInfo{"error", ledger, reads, kScene},
    CommandInfo{"counts", ledger, reads, kScene},
    CommandInfo{"cuts", root, reads, kCuts},
    CommandInfo{"history", ledger, reads, kHistory},
    CommandInfo{"stats", ledger, reads, kScene},
    CommandInfo{"owner", root, reads, kOwner},
    CommandInfo{"box", root, reads, kBox},
    CommandInfo{"neighbours", root, reads, kNeighbours},
    CommandInfo{"assign", ranks, reads, kAssign},
    CommandInfo{"fetch", ranks, reads, kFetch},
    CommandInfo{"quality", ranks, reads, kQuality, !kFiles, kGivesWay},
    CommandInfo{"compare", ranks, reads, kCompare, !kFiles, kGivesWay},
    CommandInfo{"halo", ranks, reads, kHalo, !kFiles, kGivesWay},
    CommandInfo{"write_parts", ranks, reads, kWriteParts, kFiles, kGivesWay},
    CommandInfo{"scene.create", ranks, changes, kCreate, !kFiles, !kGivesWay, kLarge},
    CommandInfo{"scene.drop", ranks, changes, kScene},
    CommandInfo{"count", ledger, changes, kCount},
    CommandInfo{"push", ranks, changes, kPush, !kFiles, !kGivesWay, kLarge},
    CommandInfo{"rebalance", ranks, changes, kRebalance, !kFiles, kGivesWay},
    CommandInfo{"load", ranks, changes, kLoad, kFiles, kGivesWay},
};

}  // namespace

std::span<const CommandInfo> commands() { return kCommands; }

const CommandInfo* find_command(std::string_view name) {
  const auto* found =
      std::find_if(kCommands.begin(), kCommands.end(), [name](const auto& command) { return command.name == name; });
  return found == kCommands.end() ? nullptr : found;
}

void keep_known_fields(wire::Json& request, const CommandInfo& command) {
  for (auto entry = request.begin(); entry != request.end();) {
    const std::string_view key = entry.key();
    const bool known = key == "command" || key == "deadline_seconds" ||
                       std::find(command.fields.begin(), command.fields.end(), key) != command.fields.end();
    entry = known && !entry->is_null() ? std::next(entry) : request.erase(entry);
  }
}

bool changes_scene(const wire::Json& request, const CommandInfo& command) {
  if (command.effect == Effect::reads) return false;
  return !wire::is_true(request, "dry_run");  // the service refuses a wrong type
}

}  // namespace rcb::api
