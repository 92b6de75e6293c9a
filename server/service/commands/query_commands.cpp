// Queries: nothing here changes a scene.
#include <algorithm>

#include <fmt/format.h>

#include "common/base/axis_names.hpp"
#include "common/base/random.hpp"
#include "common/wire/limits.hpp"
#include "server/api/lists.hpp"
#include "server/service/commands/cuts_json.hpp"
#include "server/service/commands/geometry_fields.hpp"
#include "server/service/context/collective.hpp"
#include "server/service/context/context.hpp"

namespace rcb::service {
namespace {

using api::given;
using api::put_list;

Response owner(Context&, Scene& s, const wire::Json& request) {
  const auto position = point_field(request, "position", "position", s.options.dims);
  if (!position.ok()) return failed(position.status());
  const auto id = wire::integer_field_or(request, "id", 0, wire::kIntegerMax, -1);
  if (!id.ok()) return failed(id.status());
  wire::Json json{{"scene", s.name}, {"epoch", s.epoch}};
  if (id.value() >= 0) {
    json["owner"] = s.tree->part_of(position.value(), id.value());
    return done(std::move(json));
  }
  const std::vector<int> candidates = s.tree->candidates(position.value());
  if (candidates.size() == 1) {
    json["owner"] = candidates.front();
  } else {
    json["owner"] = nullptr;
  }
  Response response = done(std::move(json));
  if (candidates.size() > 1) put_list<int>(response, response.json, "candidates", candidates);
  return response;
}

Response box(Context& context, Scene& s, const wire::Json& request) {
  const auto box = box_fields(request, "", s.options.dims);
  if (!box.ok()) return failed(box.status());
  const auto periodic = periodic_field(request, s.options.dims);
  if (!periodic.ok()) return failed(periodic.status());
  if (!context.root()) return {};
  const auto parts = s.snapshot().box(*box, *periodic);
  if (!parts.ok()) return failed(parts.status());
  Response response = done({{"scene", s.name}, {"epoch", s.epoch}});
  put_list<int>(response, response.json, "parts", *parts);
  return response;
}

// Whether rank 0 has memory for an answer of so many bytes a particle, and for gathering it. Collective. Errors:
// too_large.
Status check_room(Context& context, const Scene& scene, std::uint64_t bytes_each) {
  constexpr std::uint64_t kGathering = 4 * sizeof(double);  // the order, twice; an array as bytes, and as values
  Status room = agree_room(context.comm, context.root() ? scene.n * (bytes_each + kGathering) : 0,
                           fmt::format("an answer about {} particles", scene.n));
  if (room.ok()) return room;
  return {room.code(), room.message(), "write_parts has every rank write its own"};
}

template <typename T>
Status append_sorted(Context& context, Response& response, const char* name, const char* dtype,
                     std::span<const T> values, const Buffer<std::uint64_t>& order) {
  if (Status status = context.check_time(); !status.ok()) return status;
  const auto gathered = gather_values<T>(context.comm, values);
  Buffer<T> sorted(order.size());
  for (std::size_t k = 0; k < order.size(); ++k) sorted[k] = gathered[order[k]];
  if (context.root())
    response.arrays.push_back(make_array(name, dtype, order.size(), sorted.template release_as<std::byte>()));
  return {};
}

// Appends the particles of all ranks in ascending id: id, then positions and weight if `positions`, then part. Errors:
// those of check_time. Collective.
Status append_particles(Context& context, const Scene& scene, bool positions, Response& response) {
  const auto dims = static_cast<std::uint64_t>(scene.options.dims);
  const std::uint64_t each = 12 + (positions ? 8 * (dims + (scene.particles.has_weights ? 1U : 0U)) : 0);
  if (Status room = check_room(context, scene, each); !room.ok()) return room;
  const auto ids = gather_values<particles::Id>(context.comm, scene.particles.id.span());
  const Buffer<std::uint64_t> order = order_by_id(ids);
  Status status = append_sorted<particles::Id>(context, response, "id", "<i8", scene.particles.id.span(), order);
  for (std::size_t a = 0; positions && a < static_cast<std::size_t>(scene.options.dims) && status.ok(); ++a)
    status = append_sorted<double>(context, response, kAxisNames[a], "<f8", scene.particles.position[a].span(), order);
  if (positions && scene.particles.has_weights && status.ok())
    status = append_sorted<double>(context, response, "w", "<f8", scene.particles.weight.span(), order);
  if (status.ok()) status = append_sorted<std::int32_t>(context, response, "part", "<i4", scene.part.span(), order);
  return status;
}

Response assign(Context& context, Scene& s, const wire::Json& request) {
  const auto checksum = wire::bool_field(request, "checksum");
  if (!checksum.ok()) return failed(checksum.status());
  Response response = done({{"epoch", s.epoch}, {"n", s.n}, {"hash", wire::hex64(s.hash)}});
  if (Status status = append_particles(context, s, false, response); !status.ok()) return failed(std::move(status));
  if (checksum.value()) {
    std::uint64_t sum = 0;
    for (std::size_t i = 0; i < s.part.size(); ++i)
      sum += mix64(static_cast<std::uint64_t>(s.particles.id[i]) + mix64(static_cast<std::uint64_t>(s.part[i])));
    context.comm.all_sum({&sum, 1});
    response.json["checksum"] = wire::hex64(sum);
  }
  return response;
}

Response fetch(Context& context, Scene& s, const wire::Json&) {
  Response response = done({{"epoch", s.epoch}, {"n", s.n}});
  if (Status status = append_particles(context, s, true, response); !status.ok()) return failed(std::move(status));
  return response;
}

// A request for a page says where it begins and how many items it wants, the answer where the next page begins. A
// request without these gets everything, or is refused if that is too much for one answer; it never gets a part.
Response cuts(Context& context, Scene& s, const wire::Json& request) {
  const int parts = s.options.parts;
  const auto list = given(request, "list") ? wire::string_field(request, "list", 16) : std::string();
  if (!list.ok()) return failed(list.status());
  const bool regions = *list == "regions";
  const bool arrays = *list == "arrays";
  if (!regions && !arrays && *list != "cuts" && !list->empty())
    return failed(
        {Code::invalid_argument, fmt::format("there is no list '{}'", *list), "lists: cuts, regions, arrays"});
  if ((list->empty() || arrays) && (given(request, "from") || given(request, "count")))
    return failed({Code::invalid_argument, "'from' and 'count' are for pages", "lists with pages: cuts, regions"});
  if (arrays) {
    Response response;
    if (context.root()) response.status = put_cut_arrays(context, response, response.json, s);
    return response;
  }
  if (list->empty() && static_cast<std::size_t>(parts) > wire::kListedMax)
    return failed({Code::too_large, fmt::format("the cuts of {} parts don't fit into one answer", parts),
                   R"(ask for them by pages: "list", "from" and "count", as rcbctl cuts does)"});
  const auto total = static_cast<std::uint64_t>(regions ? parts : parts - 1);
  const auto page = api::read_page(request, total, 0, wire::kListedMax);
  if (!page.ok()) return failed(page.status());
  if (!context.root()) return {};
  wire::Json json{{"epoch", s.epoch},
                  {"method", cuts::method_name(s.tree->method)},
                  {"parts", parts},
                  {"hash", wire::hex64(s.hash)}};
  if (page->from == 0) json["narrowest_region"] = narrowest_json(s.snapshot());
  const auto from = static_cast<int>(page->from);
  const auto end = static_cast<int>(page->end);
  if (!regions) json["cuts"] = cuts_json(*s.tree, from, end);
  if (regions) json["regions"] = regions_json(*s.tree, from, end);
  if (list->empty())
    json["regions"] = regions_json(*s.tree, 0, parts);
  else
    page->tell(json, total);
  return done(std::move(json));
}

constexpr Command kQueryCommands[] = {{"owner", owner, Needs::cuts},
                                      {"box", box, Needs::cuts},
                                      {"cuts", cuts, Needs::cuts},
                                      {"assign", assign, Needs::positions, true},
                                      {"fetch", fetch, Needs::positions, true}};

}  // namespace

std::span<const Command> query_commands() { return kQueryCommands; }

}  // namespace rcb::service
