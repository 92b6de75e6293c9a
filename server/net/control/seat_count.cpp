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
  Group* group = find(begin.scene);
  const auto seat = group == nullptr ? std::nullopt : seat_of(*group, begin.connection.get());
  if (!seat) return {Code::aborted, "another generation of this seat has opened the scene", "open it again"};
  scene::Ledger* ledger = coordinator_.scenes().find(begin.scene);
  if (ledger == nullptr) return coordinator_.unknown_scene(begin.scene);
  if (group->counting && !begin.fault.ok() && begin.step == group->counting->tally.step()) {
    end_count(*group, {begin.fault.code(), name(begin.scene, *seat) + ": " + begin.fault.message(), kRepeat});
    return begin.fault;
  }
  if (!begin.fault.ok()) return begin.fault;
  if (const Status fits = ledger->check_seat(*begin.record); !fits.ok()) {
    // A seat that repeats a step of which the others have the answer.
    if (fits.code() != Code::stale_step || !ledger->was_in_last(begin.record->session, begin.step)) return fits;
    return send_to(begin, api::repeated_to_seat(*ledger));
  }
  const auto open = coordinator_.gate(begin.scene).push;
  if (open && open->round) return send_to(begin, R"({"send":"other seats push this step"})");
  if (group->counting && group->counting->tally.step() != begin.step)
    return {Code::invalid_argument,
            fmt::format("seat {} counts step {}, the others count step {}", *seat, begin.step,
                        group->counting->tally.step()),
            "all seats count the same step"};
  if (!group->counting) open_count(begin.scene, begin.step, *group);
  SeatCount& counting = *group->counting;
  begin.session = scene::session_key(begin.record->session);
  counting.tally.put(*seat, std::move(*begin.record));
  begin.record.reset();
  const TimePoint end = begin.end;
  const auto older = std::exchange(counting.waiting[*seat], std::move(begin));
  const TimePoint before = counting.end;
  if (older) {
    older->connection->send(FrameType::failure, older->request,
                            wire::failure_json({Code::aborted, "a newer count by the same seat replaced it"}));
    counting.end = TimePoint::max();  // that of a count that was replaced counts no more
    for (const auto& one : counting.waiting)
      if (one) counting.end = std::min(counting.end, one->end);
  }
  counting.end = std::min(counting.end, end);
  if (counting.end != before) counting.timer.cancel();  // so that the deadline is heeded
  if (counting.tally.whole()) decide(*group, *ledger);
  return {};
}

Status SeatGroups::send_to(const CountBegin& begin, const std::string& json) {
  begin.connection->send_text(FrameType::reply, begin.request, json);
  return {};
}

void SeatGroups::decide(Group& group, scene::Ledger& ledger) {
  auto all = group.counting->tally.sum(ledger.now().options.parts);
  if (!all.ok()) return end_count(group, all.status());
  all->session = kSeatsSession;
  for (const auto& begin : group.counting->waiting) all->sessions.push_back(begin->session);
  const scene::CountVerdict verdict = ledger.count(*all);
  if (const auto* refused = std::get_if<Status>(&verdict.is)) return end_count(group, *refused);
  answer_count(group, api::verdict_text(ledger, verdict));
}

void SeatGroups::answer_count(Group& group, const std::string& json) { close_count(group, FrameType::reply, json); }

void SeatGroups::end_count(Group& group, const Status& why) {
  close_count(group, FrameType::failure, wire::dump_json(wire::failure_json(why)));
}

void SeatGroups::close_count(Group& group, FrameType type, const std::string& json) {
  const auto counting = std::exchange(group.counting, nullptr);
  if (counting == nullptr) return;
  counting->over = true;
  counting->timer.cancel();
  tell_counting(*counting, type, json);
}

void SeatGroups::open_count(const std::string& scene, std::int64_t step, Group& group) {
  group.counting = std::make_shared<SeatCount>(coordinator_.context(), step, group.seats.size());
  asio::co_spawn(coordinator_.context(), watch_count(coordinator_.shared_from_this(), scene, group.counting),
                 asio::detached);
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
      if (Group* group = find(scene); group != nullptr && group->counting == counting)
        end_count(*group, {Code::deadline_exceeded,
                           fmt::format("step {} of scene '{}' was given up at its deadline: {} had not counted it",
                                       counting->tally.step(), scene, missing(scene, *counting)),
                           kRepeat});
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
