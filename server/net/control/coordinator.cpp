#include "server/net/control/coordinator.hpp"

#include <algorithm>
#include <chrono>
#include <numeric>
#include <utility>

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include "common/auth/proof.hpp"
#include "server/api/cut_arrays.hpp"
#include "server/api/ledger_answers.hpp"
#include "server/net/control/session.hpp"
#include "server/net/sockets/file_thread.hpp"

namespace rcb::net {

using wire::FrameType;
using wire::Json;

namespace {

// Milliseconds, then random bits: above those of scenes made earlier.
std::uint64_t new_incarnation() {
  constexpr unsigned kRandomBits = 22;
  const auto time = std::chrono::system_clock::now().time_since_epoch();
  const auto before = static_cast<std::uint64_t>(std::chrono::duration_cast<std::chrono::milliseconds>(time).count());
  return before << kRandomBits | wire::parse_hex64(auth::random_hex(8)).value() >> (64 - kRandomBits);
}

}  // namespace

Coordinator::Coordinator(asio::io_context& context, ControlOptions options, Engine& engine)
    : context_(context),
      options_(std::move(options)),
      instance_(auth::random_hex(8)),
      engine_(engine),
      answers_(options_.bulk_bytes_max),
      large_requests_(wire::kLargeRequestBytesMax),
      scenes_(options_.keeping),
      memory_bytes_(static_cast<std::size_t>(options_.ranks)) {}

void Coordinator::leave(Session* session) {
  sessions_.erase(session);
  const Connection* connection = session->connection().get();
  std::vector<std::shared_ptr<OpenStep>> lost;
  for (const auto& [name, gate] : gates_)
    if (gate.step && !gate.step->by_seats() && gate.step->block_of(connection)) lost.push_back(gate.step);
  for (const auto& step : lost) groups_.abort(*step, {Code::aborted, "the client's connection was lost"});
  groups_.leave_all(connection);
}

class Coordinator::OrderReservation {
 public:
  OrderReservation(std::shared_ptr<Coordinator> of, OrderOptions order, const Json& request)
      : of_(std::move(of)), order_(std::move(order)) {
    for (const char* name : {"command", "scene"}) what_[name] = request.contains(name) ? request[name] : Json();
    of_->unfinished_.insert(this);
    if (!order_.changes.empty()) ++of_->gate(order_.changes).changes_unfinished;
  }
  OrderReservation(const OrderReservation&) = delete;
  OrderReservation& operator=(const OrderReservation&) = delete;
  // Runs on the I/O thread, as everything here.
  ~OrderReservation() { end(); }
  void end() {
    if (std::exchange(ended_, true)) return;
    of_->unfinished_.erase(this);
    order_.held.reset();
    of_->charged_bytes_ -= order_.charged_bytes;
    if (order_.changes.empty()) return;
    --of_->gate(order_.changes).changes_unfinished;
    of_->wake_queue(order_.changes);
  }
  const OrderOptions& order() const { return order_; }
  TimePoint since() const { return since_; }
  // Its command, scene and age.
  Json told() const {
    Json told = what_;
    told["seconds"] = seconds_since(since_);
    return told;
  }

 private:
  std::shared_ptr<Coordinator> of_;
  OrderOptions order_;
  Json what_;
  TimePoint since_ = now();
  bool ended_ = false;
};

Result<std::shared_ptr<Pending>> Coordinator::order(Json request, OrderOptions order) {
  std::string text = wire::dump_json(request);
  Status refused;
  if (shutting_down_)
    refused = Status(Code::unavailable, "the service is shutting down");
  else if (!order.restores && unfinished_.size() >= static_cast<std::size_t>(options_.orders_max))
    refused =
        Status(Code::busy, fmt::format("{} commands are unfinished", unfinished_.size()), "try again in a moment");
  else if (text.size() > wire::kJsonBytesMax)  // dump_json writes 1e9 as 1000000000.0
    refused = Status(Code::too_large, fmt::format("the command has {} bytes, written out in full", text.size()));
  if (!refused.ok()) {
    charged_bytes_ -= order.charged_bytes;
    return refused;
  }
  auto pending = std::make_shared<Pending>(context_);
  auto slices = std::exchange(order.slices, {});
  auto unfinished = std::make_shared<OrderReservation>(shared_from_this(), std::move(order), request);
  const OrderOptions& kept = unfinished->order();
  Order out{std::move(request),    std::move(text),       std::move(slices),
            kept.received_seconds, kept.deadline_seconds, kept.cancelled};
  auto take = [self = shared_from_this(), unfinished, pending](Answer answer) mutable {
    // The posted function may be copied, the answer should not be: hence the shared pointer.
    auto shared = std::make_shared<Answer>(std::move(answer));
    asio::post(self->context_, [self, unfinished = std::move(unfinished), pending, shared] {
      self->complete(std::move(*shared), unfinished, pending);
    });
  };
  auto done = [take = std::move(take)](Answer answer) mutable { api::complete(std::move(answer), std::move(take)); };
  unfinished.reset();  // kept alive by `done` alone from here on
  engine_.submit(std::move(out), std::move(done));
  return pending;
}

void Coordinator::complete(Answer answer, const std::shared_ptr<OrderReservation>& unfinished,
                           const std::shared_ptr<Pending>& pending) {
  const OrderOptions& order = unfinished->order();
  if (answer.change) {
    if (auto* stepped = std::get_if<scene::Stepped>(&answer.change->event)) stepped->sessions = order.sessions;
    take_change(answer);
  }
  unfinished->end();
  if (!order.changes.empty()) groups_.scene_changed(order.changes);
  if (order.then) return order.then(std::move(answer));
  pending->answer = std::move(answer);
  pending->signal.cancel();
}

void Coordinator::want_positions(const std::string& scene) {
  static constexpr std::chrono::seconds kBetween(1);
  scene::Ledger* ledger = scenes_.find(scene);
  if (ledger == nullptr || ledger->wants_positions()) return;
  std::erase_if(positions_wanted_, [](const auto& one) { return now() - one.second >= kBetween; });
  if (positions_wanted_.try_emplace(scene, now()).second) ledger->want_positions();
}

void Coordinator::restore_scenes() {
  restored_ = scenes_.restore();
  for (const auto& [name, ledger] : scenes_) {
    OrderOptions order;
    order.changes = name;
    order.restores = true;
    if (const auto& tree = ledger.now().tree) order.slices.push_back({.arrays = api::cut_arrays(*tree)});
    order.then = [self = shared_from_this(), scene = name](const Answer& answer) {
      if (answer.status.ok()) return;
      spdlog::error("scene '{}' of an earlier service can't be restored: {}", scene, answer.status.message());
      --self->restored_.scenes;
      self->restored_.steps -= self->scenes_.find(scene)->totals().steps;
      self->scenes_.forget(scene);
    };
    const auto then = order.then;
    if (const auto ordered = this->order(api::restore_order(ledger), std::move(order)); !ordered.ok())
      asio::post(context_, [then, why = ordered.status()] { then(api::failed(why)); });
  }
  if (restored_.scenes > 0)
    spdlog::info("{} scenes of an earlier service are restored, with {} steps", restored_.scenes, restored_.steps);
}

// The report is the ledger's: the ranks don't know of steps that were counts.
void Coordinator::take_change(Answer& answer) {
  const scene::Ledger* ledger = scenes_.find(answer.change->scene);
  const Json previous_step = ledger == nullptr ? Json() : wire::or_null(ledger->now().step);
  const bool creates = std::holds_alternative<scene::Created>(answer.change->event);
  const scene::StepReport* report = scenes_.take(*std::move(answer.change), creates ? new_incarnation() : 0);
  if (report == nullptr) return;
  answer.json["report"] = to_json(*report);
  if (answer.json.contains("previous_step")) answer.json["previous_step"] = previous_step;
}

void Coordinator::wake_queue(const std::string& scene) {
  gate(scene).wake();
  erase_gate_if_unused(scene);
}

void Coordinator::erase_gate_if_unused(const std::string& scene) {
  const auto found = gates_.find(scene);
  if (found == gates_.end()) return;
  const SceneGate& gate = found->second;
  const bool idle = !gate.step && !gate.counting && gate.changes_unfinished == 0;
  if (idle && gate.queue.empty() && gate.watching.empty()) gates_.erase(found);
}

void Coordinator::charge(Block& block, std::uint64_t bytes) {
  const std::uint64_t room = options_.bulk_bytes_max - std::min(charged_bytes_, options_.bulk_bytes_max);
  charged_bytes_ += bytes;
  block.charged_bytes += bytes;
  if (bytes <= room) return;
  groups_.abort(block, {Code::busy,
                        fmt::format("all pushes together have brought more than the {} bytes that the service takes",
                                    options_.bulk_bytes_max),
                        "try again when the others are done"});
}

Result<std::shared_ptr<void>> Coordinator::hold_answer(std::uint64_t bytes) {
  if (auto held = answers_.take(bytes)) return held;
  return Status(Code::busy,
                fmt::format("answers of {} bytes wait for clients that don't read them, and this one has {}",
                            answers_.taken(), bytes),
                "try again when they have been read");
}

Result<std::shared_ptr<void>> Coordinator::hold_request(std::uint64_t bytes) {
  if (auto held = large_requests_.take(bytes)) return held;
  return Status(
      Code::busy,
      fmt::format("large requests of {} bytes are unanswered, and this one has {}", large_requests_.taken(), bytes),
      "try again in a moment");
}

void Coordinator::cancel(std::atomic<bool>& cancelled) {
  cancelled = true;
  engine_.drop_cancelled();
}

void Coordinator::watch_arrival(const std::shared_ptr<Block>& block) {
  block->progress_check.expires_after(duration_of(options_.frame_seconds));
  block->progress_check.async_wait([self = shared_from_this(), weak = std::weak_ptr(block)](error_code error) {
    const auto open = weak.lock();
    // A handler whose timer has expired already still runs without an error when the timer is cancelled: hence the
    // other two.
    if (error || !open || open->given_up || !open->step->open()) return;
    const std::uint64_t seen = std::exchange(open->progress_seen, open->bytes_arrived());
    if (open->ready()) return;
    if (open->progress_seen - seen >= kProgressBytes) return self->watch_arrival(open);
    self->groups_.abort(*open, {Code::deadline_exceeded,
                                fmt::format("the push stopped arriving: {} bytes in {} s ({})",
                                            open->progress_seen - seen, self->options_.frame_seconds, open->progress()),
                                "the previous step stands; push again"});
  });
}

bool Block::ready() const { return !rows_missing && std::find(whole.begin(), whole.end(), false) == whole.end(); }

std::uint64_t Block::bytes_arrived() const {
  return std::accumulate(arrived_bytes.begin(), arrived_bytes.end(), connection->bytes_received());
}

std::string Block::progress() const {
  if (number == 0) return fmt::format("{} of {} bytes have come", charged_bytes, terms.bytes());
  return fmt::format("{} of {} ranks have their slices", std::count(whole.begin(), whole.end(), true), whole.size());
}

void Coordinator::receive_directly(const std::shared_ptr<Block>& block) {
  const PushTerms& terms = block->terms;
  block->number = ++pushes_numbered_;
  const auto ranks = static_cast<std::uint64_t>(options_.ranks);
  block->whole.assign(ranks, false);
  block->arrived_bytes.assign(ranks, 0);
  std::vector<std::optional<std::uint64_t>> expected(ranks);
  for (std::size_t r = 0; r < ranks; ++r) {
    if (terms.direct(static_cast<int>(r)) && terms.counts[r] > 0) expected[r] = terms.counts[r];
    block->whole[r] = !expected[r];
  }
  if (block->ready()) return;
  receiving_[block->number] = block;
  data_->open({block->number, terms}, expected);
}

void Coordinator::give_up(Block& block) {
  block.given_up = true;
  block.progress_check.cancel();
  // The piece that is being read comes soon, or the connection ends: until then its memory isn't free.
  if (block.rows_missing) block.connection->limit_reading(now() + duration_of(options_.frame_seconds));
  charged_bytes_ -= std::exchange(block.charged_bytes, 0);
  if (block.number != 0) refuse_directly(block.terms.id);
  receiving_.erase(block.number);
}

void Coordinator::slice_reported(int rank, const SliceReport& report) {
  const auto found = receiving_.find(report.number);
  if (found == receiving_.end()) return;
  const std::shared_ptr<Block> block = found->second;
  if (!report.status.ok()) return groups_.abort(*block, report.status);
  std::uint64_t& known = block->arrived_bytes[static_cast<std::size_t>(rank)];
  const std::uint64_t before = std::exchange(known, std::max(known, report.bytes));
  charge(*block, known - before);
  if (!report.whole || block->given_up) return;
  block->whole[static_cast<std::size_t>(rank)] = true;
  if (!block->ready()) return;
  receiving_.erase(report.number);
  groups_.block_whole(*block);
}

bool Coordinator::has_open(const PushId& id) const {
  const auto found = gates_.find(id.scene);
  return found != gates_.end() && found->second.step &&
         std::ranges::any_of(found->second.step->shares,
                             [&id](const auto& block) { return block && block->terms.id == id; });
}

void Coordinator::refuse_directly(const PushId& id) {
  if (data_ != nullptr) data_->drop(id);
}

void Coordinator::serve_data(DataPlane& plane, const std::string& endpoint, std::vector<std::string> addresses) {
  data_ = &plane;
  data_addresses_[endpoint] = std::move(addresses);
}

const std::vector<std::string>& Coordinator::data_addresses(const std::string& endpoint) const {
  static const std::vector<std::string> kNone;
  const auto found = data_addresses_.find(endpoint);
  return found == data_addresses_.end() ? kNone : found->second;
}

Json Coordinator::unfinished_json() const {
  const auto oldest = std::ranges::min_element(unfinished_, {}, &OrderReservation::since);
  return {{"commands", unfinished_.size()}, {"oldest", oldest == unfinished_.end() ? Json() : (*oldest)->told()}};
}

void Coordinator::shut_down(const std::string& why, std::function<void()> told) {
  if (ended_) return told();
  shutdown_callbacks_.push_back(std::move(told));
  if (std::exchange(shutting_down_, true)) return;
  spdlog::info("shutting down: {}", why);
  if (options_.told_to_end) (void)FileThread::of(context_).run(options_.told_to_end, [] {});
  std::vector<std::string> scenes;
  for (auto& [name, gate] : gates_) {
    scenes.push_back(name);
    gate.wake();
  }
  const Status ends(Code::aborted, "the service is shutting down");
  for (const std::string& scene : scenes) {
    if (const auto step = gate(scene).step) groups_.abort(*step, ends);
    groups_.end_count(scene, ends);
    erase_gate_if_unused(scene);
  }
  // Orders that may be cancelled end early, unless they have begun to change a scene.
  for (const OrderReservation* one : unfinished_)
    if (one->order().cancelled) one->order().cancelled->store(true);
  engine_.drop_cancelled();
  Order order;
  order.request = {{"command", "shutdown"}};
  order.text = wire::dump_json(order.request);
  engine_.submit(std::move(order), [self = shared_from_this()](const Answer&) {
    asio::post(self->context_, [self] { self->say_goodbye(); });
  });
}

void Coordinator::say_goodbye() {
  ended_ = true;
  for (auto& told : std::exchange(shutdown_callbacks_, {})) told();
  for (Session* session : sessions_) session->say_goodbye();
}

}  // namespace rcb::net
