// SeatGroups, part 2: a step that is pushed, from its first block to the last answer.
#include <algorithm>
#include <utility>

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include "server/api/ledger_answers.hpp"
#include "server/net/control/push_order.hpp"
#include "server/net/control/seats.hpp"

namespace rcb::net {

using wire::FrameType;

std::shared_ptr<Block> OpenStep::block_of(const Connection* connection) const {
  const auto its = [connection](const auto& block) { return block && block->connection.get() == connection; };
  const auto found = std::ranges::find_if(shares, its);
  return found == shares.end() ? nullptr : *found;
}

std::string OpenStep::who() const {
  return by_seats() ? fmt::format("{} seats", shares.size()) : fmt::format("'{}'", shares.front()->client);
}

std::string OpenStep::progress() const {
  if (!by_seats()) return shares.front()->progress();
  const auto whole = std::ranges::count_if(shares, [](const auto& block) { return block && block->ready(); });
  return fmt::format("{} of {} seats", whole, shares.size());
}

bool OpenStep::all_ready() {
  while (ready < shares.size() && shares[ready] && shares[ready]->ready()) ++ready;
  return ready == shares.size();
}

Result<Role> SeatGroups::role_of(const PushId& id, const Connection* connection) const {
  Role role{id.session};
  if (knows(id.scene, connection)) {
    const Group& group = *find(id.scene);
    const auto seat = seat_of(group, connection);
    if (!seat)
      return Status(Code::aborted, fmt::format("another generation of this seat has opened scene '{}'", id.scene),
                    "open the scene again with a higher generation");
    role = {kSeats, *seat, group.seats.size()};
  } else if (Status free = check_free(id.scene); !free.ok()) {
    return free;
  }
  const auto& open = coordinator_.gate(id.scene).step;
  if (!open || open->by == role.by) return role;
  return Status(Code::busy,
                fmt::format("{} has had a push of scene '{}' open for {:.1f} s ({})", open->who(), id.scene,
                            seconds_since(open->started), open->progress()),
                "try again when it is done");
}

Result<std::shared_ptr<OpenStep>> SeatGroups::step_for(const PushId& id, const Role& role) {
  auto step = coordinator_.gate(id.scene).step;
  const auto older = step ? step->shares[role.seat] : nullptr;
  if (older && older->terms.id.attempt >= id.attempt)
    return Status(Code::aborted, fmt::format("attempt {} of step {} is open, which is not older than {}",
                                             older->terms.id.attempt, step->number, id.attempt));
  if (older && step->shares.size() == 1) {
    abort(*step, {Code::aborted, "a newer attempt of the same session replaced it"});
    step.reset();
  }
  if (step && step->number != id.step)
    return Status(Code::invalid_argument,
                  fmt::format("seat {} pushes step {}, the others push step {}", role.seat, id.step, step->number),
                  "all seats push the same step");
  if (step && older) coordinator_.give_up(*older);
  if (step) return step;
  step = std::make_shared<OpenStep>(coordinator_.context(), id, role);
  coordinator_.gate(id.scene).step = step;
  const auto self = coordinator_.shared_from_this();
  const auto waits_for = [self, step = step.get()] {
    return step->ordered ? self->engine_in_words() : self->groups().missing(*step);
  };
  const auto late = [self, step = step.get()] { self->groups().late(*step); };
  asio::co_spawn(coordinator_.context(), watch(self->options().notice_seconds, step, waits_for, late), asio::detached);
  return step;
}

Result<std::shared_ptr<Block>> SeatGroups::begin(const PushId& id, Asker asker, const wire::Json& push,
                                                 std::uint64_t bulk_bytes) {
  // While this push waited for its turn, much may have changed.
  const auto role = role_of(id, asker.connection.get());
  if (!role.ok()) return role.status();
  const scene::Ledger* ledger = coordinator_.scenes().find(id.scene);
  if (ledger == nullptr) return coordinator_.unknown_scene(id.scene);
  if (ledger->was_in_last(id.session, id.step)) {
    asker.connection->send_text(FrameType::reply, asker.request, api::repeated(*ledger));
    return std::shared_ptr<Block>();
  }
  const ControlOptions& options = coordinator_.options();
  auto terms = read_push_terms(push, id, ledger->now(), options.ranks, options.bulk_bytes_max, role->seats);
  if (!terms.ok()) return terms.status();
  auto block = std::make_shared<Block>(coordinator_.context(), std::move(asker), std::move(*terms));
  block->seat = role->seat;
  block->memory = push.value("memory", wire::Json());
  block->rows_missing = block->terms.n > 0 && !block->terms.to_ranks();
  if (block->rows_missing) {
    auto slice = make_slice(push, bulk_bytes, block->terms, block->terms.n);
    if (!slice.ok()) return slice.status();
    block->slice = std::move(*slice);
  }
  if (const auto& counting = coordinator_.gate(id.scene).counting; counting && counting->number != id.step)
    return Status(
        Code::invalid_argument,
        fmt::format("seat {} pushes step {}, the others count step {}", role->seat, id.step, counting->number),
        "all seats bring the same step");
  const auto step = step_for(id, *role);
  if (!step.ok()) return step.status();
  if (coordinator_.gate(id.scene).counting)
    answer_count(id.scene, FrameType::reply,
                 wire::dump_json({{"send", fmt::format("{} pushes this step", name(id.scene, role->seat))}}));
  block->step = *step;
  (*step)->put(role->seat, block);
  (*step)->ready = std::min((*step)->ready, role->seat);
  coordinator_.watch_arrival(block);
  if (block->terms.direct()) coordinator_.receive_directly(block);
  if (Status fits = check_together(**step); !fits.ok()) abort(**step, fits);
  if (!block->given_up && block->ready()) block_whole(*block);
  return block;
}

Status SeatGroups::check_together(const OpenStep& step) const {
  if (step.begun < step.shares.size()) return {};
  std::uint64_t n = 0, inserted = 0, removed = 0, bytes = 0;
  const Block* with_rows = nullptr;
  for (const auto& block : step.shares) {
    const PushTerms& terms = block->terms;
    n += terms.n;
    inserted += terms.inserted;
    removed += terms.removed;
    bytes += terms.bytes();
    if (terms.n == 0) continue;
    if (with_rows != nullptr && with_rows->terms.weights != terms.weights)
      return {Code::invalid_argument,
              fmt::format("{} and {} don't both push weights", name(step.scene, with_rows->seat),
                          name(step.scene, block->seat)),
              "all seats push weights, or none does"};
    with_rows = block.get();
  }
  if (const std::uint64_t most = coordinator_.options().bulk_bytes_max; bytes > most)
    return {Code::too_large, fmt::format("the seats push {} bytes together, at most {} are taken", bytes, most),
            "start the service with a larger --bulk-bytes, or on a larger machine"};
  const scene::SceneState& scene = coordinator_.scenes().find(step.scene)->now();
  return scene.step ? scene::check_conserved(step.scene, scene.n, n, inserted, removed) : Status();
}

void SeatGroups::block_whole(const Block& block) {
  if (block.step->all_ready()) order(block.step);
}

void SeatGroups::close(OpenStep& step) {
  SceneGate& gate = coordinator_.gate(step.scene);
  RCB_CHECK(gate.step.get() == &step, "the step isn't the open one");
  for (const auto& block : step.shares)
    if (block) block->progress_check.cancel();
  gate.step.reset();
  gate.wake();
}

void SeatGroups::order(const std::shared_ptr<OpenStep>& step) {
  step->ordered = true;
  close(*step);
  auto [request, options] = order_of(*step, *coordinator_.scenes().find(step->scene));
  options.received_seconds = seconds_since(step->started);
  options.deadline_seconds = std::max(std::chrono::duration<double>(step->end - step->started).count(), 0.0);
  request["deadline_seconds"] = options.deadline_seconds;
  options.then = [coordinator = coordinator_.shared_from_this(), step](Answer answer) {
    coordinator->groups().answered(*step, std::move(answer));
  };
  const auto pending = coordinator_.order(std::move(request), std::move(options));
  coordinator_.erase_gate_if_unused(step->scene);
  if (pending.ok()) return;
  for (const auto& block : step->shares)
    if (block->number != 0) coordinator_.refuse_directly(block->terms.id);
  answered(*step, api::failed(pending.status()));
}

void SeatGroups::answered(OpenStep& step, Answer answer) {
  if (!answer.status.ok())
    spdlog::info("step {} of scene '{}' by {}: {}: {}", step.number, step.scene, step.who(),
                 code_name(answer.status.code()), answer.status.message());
  const bool told = std::exchange(step.over, true);
  step.timer.cancel();
  if (!told && !answer.status.ok()) step.tell(FrameType::failure, wire::dump_json(wire::failure_json(answer.status)));
  const auto blocks = std::exchange(step.shares, {});  // which hold the step
  if (told || !answer.status.ok()) return;
  const auto arrays = std::make_shared<const std::vector<wire::Array>>(std::move(answer.arrays));
  if (!arrays->empty()) answer.json["arrays"] = wire::describe(*arrays);
  const std::string with_cuts = wire::dump_json(answer.json);  // for who has said which it knows
  answer.json.erase("cuts");
  answer.json.erase("arrays");
  const std::string text = wire::dump_json(answer.json);
  for (const auto& one : blocks)
    if (one->terms.cuts_known)
      one->connection->send_text(FrameType::reply, one->request, with_cuts, arrays);
    else
      one->connection->send_text(FrameType::reply, one->request, text);
}

void SeatGroups::abort(OpenStep& step, const Status& why) {
  if (!step.open()) return;
  spdlog::info("step {} of scene '{}' by {} given up: {}", step.number, step.scene, step.who(), why.message());
  step.over = true;
  step.timer.cancel();
  const auto keep = coordinator_.gate(step.scene).step;  // close() and its blocks let go of it
  close(step);
  step.tell(FrameType::failure, wire::dump_json(wire::failure_json(why)));
  for (const auto& one : std::exchange(step.shares, {}))
    if (one) coordinator_.give_up(*one);
  coordinator_.erase_gate_if_unused(step.scene);
}

void SeatGroups::abort(const Block& block, const Status& why) {
  const OpenStep& step = *block.step;
  const std::string who = step.by_seats() ? name(step.scene, block.seat) + ": " : "";
  abort(*block.step, {why.code(), who + why.message(), why.hint()});
}

void SeatGroups::late(OpenStep& step) {
  if (!step.ordered)
    return abort(step, {Code::deadline_exceeded,
                        fmt::format("step {} of scene '{}' was given up at its deadline: {} had not pushed it",
                                    step.number, step.scene, missing(step)),
                        "the previous step stands; push again"});
  step.over = true;
  const Status why(Code::deadline_exceeded,
                   fmt::format("step {} wasn't committed at its deadline; it goes on", step.number),
                   "push it again to hear what came of it");
  step.tell(FrameType::failure, wire::dump_json(wire::failure_json(why)));
}

}  // namespace rcb::net
