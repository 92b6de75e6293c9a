// Reads: nothing here changes a scene.
#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "common/base/random.hpp"
#include "server/service/collective.hpp"
#include "server/service/context.hpp"
#include "server/service/cuts_json.hpp"

namespace rcb::service {
namespace {

constexpr const char* kAxisNames[] = {"x", "y", "z"};

Response error(Context& context, const wire::Json& request) {
  const auto scene = find_pushed_scene(context, request);
  if (!scene.ok()) return failed(scene.status());
  const Scene& s = *scene.value();
  return done({{"scene", s.name},
               {"step", *s.step},
               {"epoch", s.epoch},
               {"error", s.loads.error},
               {"imbalance", s.loads.imbalance},
               {"tolerance", wire::number_json(s.options.tolerance)}});
}

Response counts(Context& context, const wire::Json& request) {
  const auto scene = find_pushed_scene(context, request);
  if (!scene.ok()) return failed(scene.status());
  const Scene& s = *scene.value();
  wire::Json json{{"epoch", s.epoch}, {"counts", s.loads.counts}, {"targets", s.loads.targets}};
  if (s.particles.has_weights) json["loads"] = s.loads.load_values;
  return done(std::move(json));
}

Response cuts(Context& context, const wire::Json& request) {
  const auto scene = find_pushed_scene(context, request);
  if (!scene.ok()) return failed(scene.status());
  if (!context.root()) return {};
  return done(cuts_json(scene.value()->tree, scene.value()->epoch));
}

Response history(Context& context, const wire::Json& request) {
  const auto scene = find_scene(context, request);
  if (!scene.ok()) return failed(scene.status());
  const auto last = wire::integer_field_or(request, "last", 0, std::numeric_limits<std::int64_t>::max(),
                                           std::numeric_limits<std::int64_t>::max());
  if (!last.ok()) return failed(last.status());
  if (!context.root()) return {};
  const auto& reports = scene.value()->history;
  const std::size_t count = std::min(reports.size(), static_cast<std::size_t>(last.value()));
  wire::Json json = wire::Json::array();
  for (std::size_t k = reports.size() - count; k < reports.size(); ++k) json.push_back(to_json(reports[k]));
  return done({{"history", std::move(json)}});
}

Response stats(Context& context, const wire::Json& request) {
  const auto scene = find_scene(context, request);
  if (!scene.ok()) return failed(scene.status());
  const SceneTotals& totals = scene.value()->totals;
  return done({{"scene", scene.value()->name},
               {"steps", totals.steps},
               {"repartitions", totals.repartitions},
               {"bytes", totals.bytes},
               {"drifted", totals.drifted},
               {"moved", totals.moved},
               {"migrated", totals.migrated},
               {"scanned", totals.scanned},
               {"searched", totals.searched},
               {"rounds", totals.rounds},
               {"reductions", totals.reductions},
               {"skipped", totals.skipped},
               {"asked", totals.asked},
               {"seconds", to_json(totals.seconds)}});
}

// A field of exactly `dims` finite numbers.
Result<geometry::Point> point_field(const wire::Json& request, const char* name, int dims) {
  const auto values = wire::numbers_field_or_empty(request, name, 16);
  if (!values.ok()) return values.status();
  if (values->size() != static_cast<std::size_t>(dims))
    return Status(Code::invalid_argument,
                  fmt::format("{}: {} number{} given, the scene has {} dimension{}", name, values->size(),
                              values->size() == 1 ? "" : "s", dims, dims == 1 ? "" : "s"),
                  "give one number a dimension");
  geometry::Point point{};
  for (std::size_t a = 0; a < values->size(); ++a) {
    point[a] = values.value()[a];
    if (!std::isfinite(point[a]))
      return Status(Code::not_finite, fmt::format("{}[{}] is {}: must be finite", name, a, point[a]));
  }
  return point;
}

Response owner(Context& context, const wire::Json& request) {
  const auto scene = find_pushed_scene(context, request);
  if (!scene.ok()) return failed(scene.status());
  const Scene& s = *scene.value();
  const auto position = point_field(request, "position", s.options.dims);
  if (!position.ok()) return failed(position.status());
  const auto id = wire::integer_field_or(request, "id", 0, std::numeric_limits<std::int64_t>::max(), -1);
  if (!id.ok()) return failed(id.status());
  wire::Json json{{"scene", s.name}, {"epoch", s.epoch}};
  if (id.value() >= 0) {
    json["owner"] = s.tree.part_of(position.value(), id.value());
    return done(std::move(json));
  }
  const std::vector<int> candidates = s.tree.candidates(position.value());
  if (candidates.size() == 1) {
    json["owner"] = candidates.front();
  } else {
    json["owner"] = nullptr;
    json["candidates"] = candidates;
  }
  return done(std::move(json));
}

Response box(Context& context, const wire::Json& request) {
  const auto scene = find_pushed_scene(context, request);
  if (!scene.ok()) return failed(scene.status());
  const Scene& s = *scene.value();
  const auto lo = point_field(request, "lo", s.options.dims);
  if (!lo.ok()) return failed(lo.status());
  const auto hi = point_field(request, "hi", s.options.dims);
  if (!hi.ok()) return failed(hi.status());
  for (std::size_t a = 0; a < static_cast<std::size_t>(s.options.dims); ++a)
    if (lo.value()[a] > hi.value()[a])
      return failed({Code::invalid_argument,
                     fmt::format("{}: lo {} is above hi {}", kAxisNames[a], lo.value()[a], hi.value()[a]),
                     "give the low corner first, then the high one"});
  return done({{"scene", s.name}, {"epoch", s.epoch}, {"parts", s.tree.parts_touching({lo.value(), hi.value()})}});
}

template <typename T>
void append_sorted(Context& context, Response& response, const char* name, const char* dtype, std::span<const T> values,
                   const Buffer<std::uint64_t>& order) {
  const auto gathered = gather_values<T>(context.comm, values);
  Buffer<T> sorted(order.size());
  for (std::size_t k = 0; k < order.size(); ++k) sorted[k] = gathered[order[k]];
  if (context.root()) response.arrays.push_back(make_array<T>(name, dtype, sorted.span()));
}

// The arrays of all ranks in ascending id: id, then positions and weight where asked, then part. Collective.
void append_particles(Context& context, const Scene& scene, bool positions, Response& response) {
  const auto ids = gather_values<particles::Id>(context.comm, scene.particles.id.span());
  const Buffer<std::uint64_t> order = order_by_id(ids);
  append_sorted<particles::Id>(context, response, "id", "<i8", scene.particles.id.span(), order);
  if (positions) {
    for (std::size_t a = 0; a < static_cast<std::size_t>(scene.options.dims); ++a)
      append_sorted<double>(context, response, kAxisNames[a], "<f8", scene.particles.position[a].span(), order);
    if (scene.particles.has_weights)
      append_sorted<double>(context, response, "w", "<f8", scene.particles.weight.span(), order);
  }
  append_sorted<std::int32_t>(context, response, "part", "<i4", scene.part.span(), order);
}

Response assign(Context& context, const wire::Json& request) {
  const auto scene = find_pushed_scene(context, request);
  if (!scene.ok()) return failed(scene.status());
  const auto checksum = wire::bool_field_or(request, "checksum", false);
  if (!checksum.ok()) return failed(checksum.status());
  const Scene& s = *scene.value();
  Response response = done({{"epoch", s.epoch}, {"n", s.n}, {"hash", wire::hex64(s.tree.hash())}});
  append_particles(context, s, false, response);
  if (checksum.value()) {
    std::uint64_t sum = 0;
    for (std::size_t i = 0; i < s.part.size(); ++i)
      sum += mix64(static_cast<std::uint64_t>(s.particles.id[i]) + mix64(static_cast<std::uint64_t>(s.part[i])));
    context.comm.all_sum({&sum, 1});
    response.json["checksum"] = wire::hex64(sum);
  }
  return response;
}

Response fetch(Context& context, const wire::Json& request) {
  const auto scene = find_pushed_scene(context, request);
  if (!scene.ok()) return failed(scene.status());
  const Scene& s = *scene.value();
  Response response = done({{"epoch", s.epoch}, {"n", s.n}, {"step", *s.step}});
  append_particles(context, s, true, response);
  return response;
}

Response plan(Context& context, const wire::Json& request) {
  const auto scene = find_pushed_scene(context, request);
  if (!scene.ok()) return failed(scene.status());
  const Scene& s = *scene.value();
  const std::uint64_t held = s.part.size();
  const auto held_by_rank = gather_values<std::uint64_t>(context.comm, {&held, 1});
  const auto ids = gather_values<particles::Id>(context.comm, s.particles.id.span());
  const auto parts = gather_values<std::int32_t>(context.comm, s.part.span());
  Response response = done({{"counts", std::vector<std::uint64_t>(held_by_rank.begin(), held_by_rank.end())},
                            {"plan", {{"version", s.plan_version}, {"checksum", wire::hex64(s.plan_checksum)}}},
                            {"parts", s.options.parts},
                            {"ranks", context.comm.size()}});
  response.arrays.push_back(make_array<particles::Id>("id", "<i8", ids.span()));
  response.arrays.push_back(make_array<std::int32_t>("part", "<i4", parts.span()));
  return response;
}

constexpr Command kCommands[] = {{"error", error},       {"counts", counts},  {"cuts", cuts}, {"history", history},
                                 {"stats", stats},       {"owner", owner},    {"box", box},   {"assign", assign, true},
                                 {"fetch", fetch, true}, {"plan", plan, true}};

}  // namespace

std::span<const Command> query_commands() { return kCommands; }

}  // namespace rcb::service
