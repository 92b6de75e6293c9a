// Reads a scene's step reports, a page at a time.
#include <algorithm>
#include <limits>

#include <fmt/format.h>

#include "client/lib/client.hpp"
#include "client/lib/scene/step_report.hpp"
#include "common/wire/field_reader.hpp"
#include "common/wire/limits.hpp"

namespace rcb::client {
namespace {

constexpr std::uint64_t kPageReports = 1000;
constexpr std::int64_t kLargest = std::numeric_limits<std::int64_t>::max();
constexpr std::uint64_t kNoLimit = kLargest;

struct Page {
  std::uint64_t from = 0;
  std::uint64_t next = 0;  // where the next page begins; the total after the last page
  std::uint64_t total = 0;
  std::uint64_t lost = 0;
};

Result<Page> read_page(const wire::Json& json) {
  wire::FieldReader fields(json);
  const std::int64_t total = fields.integer("total", 0, kLargest);
  const std::int64_t from = fields.integer("from", 0, total);
  const std::int64_t next = fields.integer_or("next", 0, total, total);
  const std::int64_t lost = fields.integer_or("lost", 0, total, 0);
  if (!fields.ok()) return Status(Code::protocol_error, "answer to 'history': " + fields.status().message());
  if (next <= from && next < total)
    return Status(Code::protocol_error, "answer to 'history': it goes on where it began");
  const auto history = json.find("history");
  if (history == json.end() || !history->is_array())
    return Status(Code::protocol_error, "answer to 'history': no list of reports");
  return Page{static_cast<std::uint64_t>(from), static_cast<std::uint64_t>(next), static_cast<std::uint64_t>(total),
              static_cast<std::uint64_t>(lost)};
}

}  // namespace

Result<HistoryRead> Client::history(const std::string& scene, const HistoryRange& range,
                                    const std::function<Status(const StepReport&)>& take, double deadline_seconds) {
  if (Status status = wire::check_scene_name(scene); !status) return status;
  HistoryRead read;
  const bool none = range.first && *range.first == 0;
  wire::Json request{{"scene", scene}};
  if (none || range.last) request["last"] = none ? 0 : std::min(*range.last, kNoLimit);
  std::uint64_t end = kNoLimit;  // set by the first page: reports of later steps are left out
  for (bool first = true;; first = false) {
    const std::uint64_t wanted = (none ? kNoLimit : range.first.value_or(kNoLimit)) - (read.reports + read.lost);
    request["count"] =
        std::min({kPageReports, wanted, first ? kPageReports : end - request["from"].get<std::uint64_t>()});
    const auto reply = call("history", request.dump(), deadline_seconds);
    if (!reply) return reply.status();
    const auto json = wire::parse_json(reply->json);
    if (!json) return json.status();
    const auto page = read_page(*json);
    if (!page) return page.status();
    if (first) {
      end = page->total;
      read.from = page->from;
    } else if (page->total < end || page->from != request["from"].get<std::uint64_t>()) {
      return Status(Code::aborted, fmt::format("scene '{}' was made anew while its history was read", scene),
                    "ask again");
    }
    for (const wire::Json& entry : (*json)["history"]) {
      if (!entry.is_object()) return Status(Code::protocol_error, "answer to 'history': a report that is no object");
      const auto report = read_report(entry);
      if (!report) return report.status();
      if (Status status = take(*report); !status) return status;
      ++read.reports;
    }
    read.lost += page->lost;
    if (page->lost > 0) read.loss = json->value("loss", "");
    if (page->next >= end || read.reports + read.lost >= range.first.value_or(kNoLimit)) return read;
    request.erase("last");
    request["from"] = page->next;
  }
}

}  // namespace rcb::client
