#include "server/net/push/data_plane.hpp"

namespace rcb::net {

wire::Json report_json(const SliceReport& report) {
  wire::Json json = report.status.ok() ? wire::Json::object() : wire::failure_json(report.status);
  json.update({{"number", report.number}, {"bytes", report.bytes}, {"whole", report.whole}});
  return json;
}

SliceReport read_report(const wire::Json& json) {
  return {json.value("number", std::uint64_t{0}), json.value("bytes", std::uint64_t{0}), json.value("whole", false),
          json.contains("failure") ? wire::status_from_failure(json) : Status()};
}

wire::Json ticket_json(const PushTicket& ticket, std::uint64_t count) {
  const PushTerms& terms = ticket.terms;
  return {{"push", "open"},
          {"number", ticket.number},
          {"scene", terms.id.scene},
          {"session", terms.id.session},
          {"step", terms.id.step},
          {"attempt", terms.id.attempt},
          {"n", count},
          {"dims", terms.dims},
          {"ranks", terms.ranks},
          {"weights", terms.weights},
          {"ids", terms.ids},
          {"single", terms.is_float32}};
}

Result<PushTicket> read_ticket(const wire::Json& json) {
  Result<PushId> id = read_push_id(json, json.value("session", ""));
  if (!id.ok()) return id.status();
  PushTicket ticket;
  ticket.number = json.value("number", std::uint64_t{0});
  ticket.terms.id = std::move(*id);
  ticket.terms.n = json.value("n", std::uint64_t{0});
  ticket.terms.dims = json.value("dims", 3);
  ticket.terms.ranks = json.value("ranks", 1);
  ticket.terms.weights = json.value("weights", false);
  ticket.terms.ids = json.value("ids", false);
  ticket.terms.is_float32 = json.value("single", false);
  return ticket;
}

}  // namespace rcb::net
