// The query with a long answer: cuts. A request for a page says where it begins and how many items it wants;
// the answer says where the next page begins. A request without these gets everything, or is refused if that is too
// much for one answer; it never gets a part.
#include <algorithm>

#include <fmt/format.h>

#include "common/wire/limits.hpp"
#include "server/api/lists.hpp"
#include "server/service/commands/cuts_json.hpp"
#include "server/service/context/context.hpp"

namespace rcb::service {
namespace {

using api::given;
using api::read_page;

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

constexpr Command kPagedCommands[] = {{"cuts", cuts, Needs::cuts}};

}  // namespace

std::span<const Command> paged_commands() { return kPagedCommands; }

}  // namespace rcb::service
