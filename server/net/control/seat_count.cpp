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

// To all that have counted.
void tell_counting(const SeatCount& counting, FrameType type, const std::string& json) {
  for (const auto& begin : counting.waiting)
    if (begin) begin->connection->send_text(type, begin->request, json);
}

}  // namespace

Status SeatGroups::count(CountBegin begin) {
  const std::string scene = begin.id.scene;
  const auto role = role_of(begin.id, begin.connection.get());
  if (!role.ok()) return role.status();
  scene::Ledger& ledger = *coordinator_.scenes().find(scene);
  SceneGate& gate = coordinator_.gate(scene);
  if (!begin.fault.ok()) {
    if (gate.counting && begin.id.step == gate.counting->tally.step())
      end_count(scene, {begin.fault.code(), name(scene, role->seat) + ": " + begin.fault.message(), kRepeat});
    return begin.fault;
  }
  const auto tell = [&begin](const std::string& json) {
    begin.connection->send_text(FrameType::reply, begin.request, json);
    return Status();
  };
  if (const Status fits = ledger.check_seat(*begin.record); !fits.ok())
    return ledger.was_in_last(begin.id.session, begin.id.step) ? tell(api::repeated(ledger)) : fits;
  if (gate.step) return tell(R"({"send":"the step is being pushed"})");
  if (gate.counting && gate.counting->tally.step() != begin.id.step)
    return {Code::invalid_argument,
            fmt::format("seat {} counts step {}, the others count step {}", role->seat, begin.id.step,
                        gate.counting->tally.step()),
            "all seats count the same step"};
  const bool fresh = !gate.counting;
  if (fresh) gate.counting = std::make_shared<SeatCount>(coordinator_.context(), begin.id.step, role->seats);
  SeatCount& counting = *gate.counting;
  counting.tally.put(role->seat, std::move(*begin.record));
  begin.record.reset();
  const TimePoint end = begin.end, before = counting.end;
  const auto older = std::exchange(counting.waiting[role->seat], std::move(begin));
  if (older) {
    older->connection->send(FrameType::failure, older->request,
                            wire::failure_json({Code::aborted, "a newer count by the same seat replaced it"}));
    counting.end = TimePoint::max();  // that of a count that was replaced counts no more
    for (const auto& one : counting.waiting)
      if (one) counting.end = std::min(counting.end, one->end);
  }
  counting.end = std::min(counting.end, end);
  if (counting.end != before) counting.timer.cancel();  // so that the deadline is heeded
  if (counting.tally.whole())
    decide(scene, ledger);
  else if (fresh)
    asio::co_spawn(coordinator_.context(), watch_count(coordinator_.shared_from_this(), scene, gate.counting),
                   asio::detached);
  return {};
}

void SeatGroups::decide(const std::string& scene, scene::Ledger& ledger) {
  const SeatCount& counting = *coordinator_.gate(scene).counting;
  auto all = counting.tally.sum(ledger.now().options.parts);
  if (!all.ok()) return end_count(scene, all.status());
  for (const auto& begin : counting.waiting) all->sessions.push_back(scene::session_key(begin->id.session));
  const scene::CountVerdict verdict = ledger.count(*all);
  if (const auto* refused = std::get_if<Status>(&verdict.is)) return end_count(scene, *refused);
  answer_count(scene, FrameType::reply, api::verdict_text(ledger, verdict));
}

void SeatGroups::end_count(const std::string& scene, const Status& why) {
  answer_count(scene, FrameType::failure, wire::dump_json(wire::failure_json(why)));
}

void SeatGroups::answer_count(const std::string& scene, FrameType type, const std::string& json) {
  const auto counting = std::exchange(coordinator_.gate(scene).counting, nullptr);
  if (counting == nullptr) return;
  counting->over = true;
  counting->timer.cancel();
  tell_counting(*counting, type, json);
}

std::string SeatGroups::missing(const std::string& scene, const SeatCount& counting) const {
  std::vector<std::size_t> missing;
  for (std::size_t seat = 0; seat < counting.waiting.size(); ++seat)
    if (!counting.tally.has(seat)) missing.push_back(seat);
  return names_of(scene, missing);
}

awaitable<void> SeatGroups::watch_count(std::shared_ptr<Coordinator> self, std::string scene,
                                        std::shared_ptr<SeatCount> counting) {
  TimePoint notice_at = now() + duration_of(self->options().notice_seconds);
  while (!counting->over) {
    counting->timer.expires_at(std::min(notice_at, counting->end));
    co_await counting->timer.async_wait(kAwait);
    if (counting->over) break;
    if (now() >= counting->end) {
      end_count(scene, {Code::deadline_exceeded,
                        fmt::format("step {} of scene '{}' was given up at its deadline: {} had not counted it",
                                    counting->tally.step(), scene, missing(scene, *counting)),
                        kRepeat});
      self->erase_gate_if_unused(scene);
      break;
    }
    if (now() < notice_at) continue;
    const std::string notice = fmt::format("step {} of scene '{}' has waited {:.0f} s for {}", counting->tally.step(),
                                           scene, seconds_since(counting->started), missing(scene, *counting));
    tell_counting(*counting, FrameType::notice, wire::dump_json({{"notice", notice}}));
    notice_at = now() + duration_of(self->options().notice_seconds);
  }
}

}  // namespace rcb::net
