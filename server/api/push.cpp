#include "server/api/push.hpp"

#include <cmath>
#include <limits>
#include <utility>

#include <fmt/format.h>

#include "common/wire/field_reader.hpp"
#include "common/wire/limits.hpp"

namespace rcb::api {

namespace {

// By rank, adding up to the block's rows.
Status read_counts(wire::FieldReader& fields, int ranks, Push& push) {
  const std::vector<double> counts = fields.numbers("counts", static_cast<std::size_t>(ranks));
  if (!fields.ok()) return fields.status();
  if (counts.empty() && push.way != Way::sockets) return {};
  const Status odd(
      Code::invalid_argument,
      fmt::format("field 'counts': expected {} whole numbers, how many of the {} rows go to each rank", ranks, push.n));
  if (counts.size() != static_cast<std::size_t>(ranks) || !push.to_ranks()) return odd;
  std::uint64_t left = push.n;
  for (const double count : counts) {
    if (!(count >= 0 && count <= static_cast<double>(left)) || count != std::floor(count)) return odd;
    push.counts.push_back(static_cast<std::uint64_t>(count));
    left -= push.counts.back();
  }
  return left == 0 ? Status() : odd;
}

// Errors: invalid_argument.
Status read_sockets(wire::FieldReader& fields, int ranks, Push& push) {
  for (const double rank : fields.numbers("sockets", static_cast<std::size_t>(ranks))) {
    if (!(rank >= 0 && rank < ranks) || rank != std::floor(rank) ||
        (!push.by_socket.empty() && rank <= push.by_socket.back()))
      return {Code::invalid_argument, "field 'sockets': expected a list of ranks, ascending"};
    push.by_socket.push_back(static_cast<int>(rank));
  }
  if (push.counts.empty() && !push.by_socket.empty())
    return {Code::invalid_argument, "field 'sockets': the push must say in 'counts' how many rows go to each rank"};
  if (!push.ids && !push.by_socket.empty())
    return {Code::invalid_argument, "field 'sockets': rows without ids, whose numbers are in memory alone",
            "give the id of each row"};
  return fields.status();
}

// Errors: invalid_argument.
Status read_cuts_known(const wire::Json& request, Push& push) {
  const auto known = request.find("cuts_known");
  if (known == request.end() || known->is_null()) return {};
  if (!known->is_object()) return {Code::invalid_argument, "field 'cuts_known': expected an object"};
  wire::FieldReader fields(*known);
  const auto epoch = static_cast<std::uint64_t>(fields.integer_or("epoch", 0, wire::kIntegerMax, 0));
  const auto hash = wire::parse_hex64(fields.text_or("hash", 16, wire::hex64(0)));
  fields.fail(hash.status());
  if (!fields.ok()) return {Code::invalid_argument, "field 'cuts_known': " + fields.status().message()};
  push.cuts_known = {epoch, *hash};
  return {};
}

}  // namespace

// Which arrays must be there is checked with what is known of the scene; that they lie within the memory, by each rank.
Result<std::vector<SharedArray>> read_shared(const wire::Json& request) {
  const Status odd(Code::invalid_argument, "field 'memory': expected a list of objects, one for each array");
  const auto memory = request.find("memory");
  if (memory == request.end() || !memory->is_array() || memory->size() > wire::kArraysMax) return odd;
  std::vector<SharedArray> arrays;
  for (const wire::Json& entry : *memory) {
    if (!entry.is_object()) return odd;
    wire::FieldReader fields(entry);
    arrays.push_back({fields.text("name", 8), fields.integer("number", 0, wire::kIntegerMax),
                      static_cast<std::uint64_t>(fields.integer("offset", 0, wire::kIntegerMax / 2)),
                      static_cast<std::uint64_t>(fields.integer("stride", 1, wire::kSharedStrideMax))});
    if (!fields.ok()) return fields.status();
  }
  return arrays;
}

Result<PushId> read_push_id(const wire::Json& request, std::string session) {
  wire::FieldReader fields(request);
  PushId id;
  id.scene = fields.text("scene", 256);
  if (fields.ok()) fields.fail(wire::check_scene_name(id.scene));
  id.session = std::move(session);
  id.step = fields.integer("step", 0, wire::kStepMax);
  id.attempt = fields.integer_or("attempt", 0, wire::kIntegerMax, 0);
  if (!fields.ok()) return fields.status();
  return id;
}

Way read_way(wire::FieldReader& fields) {
  const std::string name = fields.word("way", {"endpoint", "sockets", "shared-memory"});
  for (const Way way : {Way::sockets, Way::shared_memory})
    if (name == name_of(way)) return way;
  return Way::endpoint;
}

Result<Push> read_push(const wire::Json& request, PushId id, int ranks) {
  wire::FieldReader fields(request);
  Push push{.id = std::move(id)};
  push.n = static_cast<std::uint64_t>(fields.integer("n", 0, wire::kParticlesMax));
  push.way = read_way(fields);
  push.weights = fields.flag("weights");
  push.ids = fields.flag("ids");
  push.is_float32 = fields.word("dtype", {"<f8", "<f4"}) == "<f4";
  push.inserted = fields.particles("inserted");
  push.removed = fields.particles("removed");
  if (fields.has("incarnation")) {
    const auto incarnation = wire::parse_hex64(fields.text("incarnation", 16));
    fields.fail(incarnation.status());
    if (incarnation.ok()) push.incarnation = *incarnation;
  }
  if (fields.has("drifted")) push.drifted = fields.particles("drifted");
  if (fields.has("step_seconds"))
    push.step_seconds = fields.number_or("step_seconds", 0, std::numeric_limits<double>::max(), 0);
  if (push.drifted > push.n) fields.fail({Code::invalid_argument, "field 'drifted': more than the rows of the push"});
  if (!fields.ok()) return fields.status();
  if (Status status = read_cuts_known(request, push); !status.ok()) return status;
  if (Status status = read_counts(fields, ranks, push); !status.ok()) return status;
  if (!push.from_memory()) return push;
  auto shared = read_shared(request);
  if (!shared.ok()) return shared.status();
  push.shared = std::move(*shared);
  if (Status status = read_sockets(fields, ranks, push); !status.ok()) return status;
  return push;
}

}  // namespace rcb::api
