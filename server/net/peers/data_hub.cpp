#include "server/net/peers/data_hub.hpp"

#include <spdlog/spdlog.h>

namespace rcb::net {

DataHub::DataHub(DoorbellHub& doorbells, DataPort& own, int ranks) : doorbells_(doorbells), own_(own), ranks_(ranks) {}

void DataHub::open(const PushTicket& ticket, std::span<const std::optional<std::uint64_t>> counts) {
  for (int rank = 1; rank < ranks_; ++rank)
    if (const auto count = counts[static_cast<std::size_t>(rank)]) doorbells_.tell(rank, ticket_json(ticket, *count));
  if (!counts[0]) return;
  PushTicket mine = ticket;
  mine.terms.n = *counts[0];
  own_.open(std::move(mine));
}

void DataHub::drop(const PushId& id) {
  const wire::Json message{
      {"push", "drop"}, {"scene", id.scene}, {"session", id.session}, {"step", id.step}, {"attempt", id.attempt}};
  for (int rank = 1; rank < ranks_; ++rank) doorbells_.tell(rank, message);
  own_.drop(id);
}

void apply_hub_message(DataPort& port, const wire::Json& message) {
  if (message.value("push", "") == "open") {
    auto ticket = read_ticket(message);
    RCB_CHECK(ticket.ok(), ticket.status().message());
    port.open(std::move(*ticket));
  } else if (message.value("push", "") == "drop") {
    const auto id = read_push_id(message, message.value("session", ""));
    RCB_CHECK(id.ok(), id.status().message());
    port.drop(*id);
  }
}

}  // namespace rcb::net
