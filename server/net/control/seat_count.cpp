// SeatGroups, part 3: a step that all seats count, until all have, and the ledger has decided.
#include <utility>

#include <fmt/format.h>

#include "server/api/ledger_answers.hpp"
#include "server/net/control/coordinator.hpp"
#include "server/net/control/seats.hpp"

namespace rcb::net {

using wire::FrameType;

namespace {

constexpr const char* kRepeat = "the previous step stands; count or push again";

}  // namespace

Status SeatGroups::count(const PushId& id, Asker asker, Result<scene::CountRecord> counted) {
  const auto role = role_of(id, asker.connection.get());
  if (!role.ok()) return role.status();
  scene::Ledger& ledger = *coordinator_.scenes().find(id.scene);
  SceneGate& gate = coordinator_.gate(id.scene);
  if (const Status& fault = counted.status(); !fault.ok()) {
    const Status named(fault.code(), name(id.scene, role->seat) + ": " + fault.message(), kRepeat);
    if (gate.counting && id.step == gate.counting->number) end_count(id.scene, named);
    if (const auto step = gate.step; step && id.step == step->number) abort(*step, named);
    return fault;
  }
  const auto tell = [&asker](const std::string& json) {
    asker.connection->send_text(FrameType::reply, asker.request, json);
    return Status();
  };
  if (const Status fits = ledger.check_seat(*counted); !fits.ok())
    return ledger.was_in_last(id.session, id.step) ? tell(api::repeated(ledger)) : fits;
  if (gate.step) return tell(R"({"send":"the step is being pushed"})");
  if (auto send = ledger.always_sends()) return tell(api::verdict_text(ledger, {*std::move(send)}));
  if (gate.counting && gate.counting->number != id.step)
    return {Code::invalid_argument,
            fmt::format("seat {} counts step {}, the others count step {}", role->seat, id.step, gate.counting->number),
            "all seats count the same step"};
  const bool fresh = !gate.counting;
  if (fresh) gate.counting = std::make_shared<SeatCount>(coordinator_.context(), id, role->seats);
  const auto counting = gate.counting;
  counting->tally.put(role->seat, std::move(*counted));
  counting->put(role->seat, std::make_shared<Asker>(std::move(asker)));
  if (!counting->tally.whole()) {
    if (fresh) wait_for_counts(counting);
    return {};
  }
  auto all = counting->tally.sum(ledger.now().options.parts);
  const scene::CountVerdict verdict = all.ok() ? ledger.count(*all) : scene::CountVerdict{all.status()};
  if (const auto* refused = std::get_if<Status>(&verdict.is))
    end_count(id.scene, *refused);
  else
    answer_count(id.scene, FrameType::reply, api::verdict_text(ledger, verdict));
  return {};
}

void SeatGroups::wait_for_counts(const std::shared_ptr<SeatCount>& counting) {
  const auto missing = [self = coordinator_.shared_from_this(), counting = counting.get()] {
    std::vector<std::size_t> seats;
    for (std::size_t seat = 0; seat < counting->shares.size(); ++seat)
      if (!counting->shares[seat]) seats.push_back(seat);
    return self->groups().names_of(counting->scene, seats);
  };
  const auto late = [self = coordinator_.shared_from_this(), counting = counting.get(), missing] {
    self->groups().end_count(counting->scene,
                             {Code::deadline_exceeded,
                              fmt::format("step {} of scene '{}' was given up at its deadline: {} had not counted it",
                                          counting->number, counting->scene, missing()),
                              kRepeat});
    self->erase_gate_if_unused(counting->scene);
  };
  asio::co_spawn(coordinator_.context(), watch(coordinator_.options().notice_seconds, counting, missing, late),
                 asio::detached);
}

void SeatGroups::end_count(const std::string& scene, const Status& why) {
  answer_count(scene, FrameType::failure, wire::dump_json(wire::failure_json(why)));
}

void SeatGroups::answer_count(const std::string& scene, FrameType type, const std::string& json) {
  const auto counting = std::exchange(coordinator_.gate(scene).counting, nullptr);
  if (counting == nullptr) return;
  counting->over = true;
  counting->timer.cancel();
  counting->tell(type, json);
}

}  // namespace rcb::net
