// Queries with long answers: cuts and history. A request for a page says where it begins and how many items it wants;
// the answer says where the next page begins. A request without these gets everything, or is refused if that is too
// much for one answer; it never gets a part.
#include <algorithm>

#include <fmt/format.h>

#include "common/wire/limits.hpp"
#include "server/service/commands/cuts_json.hpp"
#include "server/service/commands/with_reports.hpp"
#include "server/service/context/context.hpp"

namespace rcb::service {
namespace {

bool given(const wire::Json& request, const char* name) {
  const auto found = request.find(name);
  return found != request.end() && !found->is_null();
}

// The items [from, end) of a list.
struct Page {
  std::uint64_t from = 0;
  std::uint64_t end = 0;

  void tell(wire::Json& json, std::uint64_t total) const {
    json["from"] = from;
    json["next"] = end < total ? wire::Json(end) : wire::Json(nullptr);
  }
};

// The page asked for by the fields "from" (`otherwise` if absent) and "count", within `total` items and of at most
// `most`. Errors: invalid_argument.
Result<Page> read_page(const wire::Json& request, std::uint64_t total, std::uint64_t otherwise, std::uint64_t most) {
  const auto from = wire::integer_field_or(request, "from", 0, wire::kIntegerMax, static_cast<std::int64_t>(otherwise));
  if (!from.ok()) return from.status();
  const auto count = wire::integer_field_or(request, "count", 1, wire::kIntegerMax, wire::kIntegerMax);
  if (!count.ok()) return count.status();
  Page page;
  page.from = std::min(static_cast<std::uint64_t>(*from), total);
  page.end = page.from + std::min({static_cast<std::uint64_t>(*count), most, total - page.from});
  return page;
}

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
  const auto page = read_page(request, total, 0, wire::kListedMax);
  if (!page.ok()) return failed(page.status());
  if (!context.root()) return {};
  wire::Json json{{"epoch", s.epoch},
                  {"method", cuts::method_name(s.tree.method)},
                  {"parts", parts},
                  {"hash", wire::hex64(s.cuts_hash())}};
  if (page->from == 0) json["narrowest_region"] = narrowest_json(s.snapshot());
  const auto from = static_cast<int>(page->from);
  const auto end = static_cast<int>(page->end);
  if (!regions) json["cuts"] = cuts_json(s.tree, from, end);
  if (regions) json["regions"] = regions_json(s.tree, from, end);
  if (list->empty())
    json["regions"] = regions_json(s.tree, 0, parts);
  else
    page->tell(json, total);
  return done(std::move(json));
}

Response history(Context& context, Scene& scene, const wire::Json& request) {
  const std::uint64_t total = scene.totals.steps;
  const auto last = wire::integer_field_or(request, "last", 0, wire::kIntegerMax, wire::kIntegerMax);
  if (!last.ok()) return failed(last.status());
  const std::uint64_t wanted = std::min(static_cast<std::uint64_t>(*last), total);
  if (given(request, "last") && given(request, "from"))
    return failed({Code::invalid_argument, "'last' and 'from' at once", "'last' says where the first page begins"});
  const bool paged = given(request, "from") || given(request, "count");
  if (!paged && wanted > wire::kReportsMax)
    return failed({Code::too_large, fmt::format("{} step reports don't fit into one answer", wanted),
                   R"(ask for them by pages: "from" and "count", as rcbctl history does, or for the "last" few)"});
  const auto page = read_page(request, total, total - wanted, wire::kReportsMax);
  if (!page.ok()) return failed(page.status());
  if (!context.root()) return {};
  return with_reports(*scene.history, page->from, page->end,
                      [page = *page, total](FoundReports found, Response& answer) {
                        wire::Json& json = answer.json;
                        json["total"] = total;
                        json["lost"] = page.end - page.from - found.reports.size();
                        if (json["lost"] != 0) json["loss"] = found.loss;
                        json["history"] = std::move(found.reports);
                        page.tell(json, total);
                      });
}

constexpr Command kPagedCommands[] = {{"cuts", cuts, Needs::positions}, {"history", history, Needs::scene}};

}  // namespace

std::span<const Command> paged_commands() { return kPagedCommands; }

}  // namespace rcb::service
