// Steps: making them here or in the worker's thread, and reading what they told.
#include "client/c/step.hpp"

#include <cmath>
#include <limits>
#include <memory>
#include <utility>

#include <fmt/format.h>

#include "client/c/call.hpp"
#include "client/c/positions.hpp"
#include "client/c/structs.hpp"

namespace rcb::c {
namespace {

struct StepAsk {
  client::Positions positions;
  client::StepOptions options;
};

Result<StepAsk> ask_of(const rcbd_scene& scene, const rcbd_positions* positions, const rcbd_step_options* options) {
  const auto rows = positions_of(positions);
  if (!rows) return rows.status();
  const auto given = read_struct(options, rcbd_step_options RCBD_STEP_OPTIONS, "RCBD_STEP_OPTIONS");
  if (!given) return given.status();
  if (given->inserted < 0 || given->removed < 0)
    return Status(Code::invalid_argument, fmt::format("{} inserted and {} removed", given->inserted, given->removed),
                  "give 0 or more");
  if (given->step < -1)
    return Status(Code::invalid_argument, fmt::format("step {}", given->step), "-1 is the next one");
  if (given->threads < 1) return Status(Code::invalid_argument, fmt::format("{} threads", given->threads));
  if (Status fits = check_deadline(given->deadline_seconds); !fits) return fits;
  client::StepOptions with{.ids = optional_array(given->ids, rows->count),
                           .weights = optional_array(given->weights, rows->count),
                           .inserted = static_cast<std::uint64_t>(given->inserted),
                           .removed = static_cast<std::uint64_t>(given->removed),
                           .send = given->send != 0,
                           .want_parts = given->want_parts != 0,
                           .want_changes = given->want_changed != 0,
                           .threads = std::max(given->threads, scene.threads),
                           .deadline_seconds = given->deadline_seconds};
  if (given->step >= 0) with.step = given->step;
  if (!(given->step_seconds < 0)) with.step_seconds = given->step_seconds;
  return StepAsk{*rows, with};
}

Status busy_scene(const std::string& name) {
  return {Code::busy, fmt::format("a step of scene '{}' was begun and is not done", name), "rcbd_wait for it"};
}

// While it lasts, `cancelled` ends waiting. An exception ends it, too.
struct Cancellable {
  Cancellable(rcbd_client& of, const std::atomic<bool>* cancelled) : client(of) { client.cancelled = cancelled; }
  Cancellable(const Cancellable&) = delete;
  Cancellable& operator=(const Cancellable&) = delete;
  ~Cancellable() { client.cancelled = nullptr; }
  rcbd_client& client;
};

// In the thread of the caller, or the worker's.
Result<client::StepResult> make_step(rcbd_scene& scene, const StepAsk& ask, const std::atomic<bool>* cancelled) {
  Result<client::StepResult> made = Status(Code::internal, "no step");
  const Left left(ask.options.deadline_seconds);
  const auto step = [&](client::Scene& open) {
    if (cancelled != nullptr && cancelled->load())
      return Status(Code::interrupted, fmt::format("cancelled; no step of scene '{}' was begun", scene.name));
    const Cancellable here(*scene.client, cancelled);
    client::StepOptions options = ask.options;
    options.deadline_seconds = left.seconds();
    made = open.step(ask.positions, options);
    return made.status();
  };
  if (Status status = scene.in_turn(left, step, cancelled); !status) return status;
  return made;
}

// What a caller gets of a step, which it may not want.
void give(rcbd_result* result, rcbd_result** to) {
  if (to == nullptr) return;
  result->retain();
  *to = result;
}

// The two columns of a list of pairs.
template <typename Pair, typename Number>
void by_column(const std::vector<Pair>& pairs, Number Pair::*second, std::vector<std::int64_t>& rows,
               std::vector<std::int32_t>& numbers) {
  rows.reserve(pairs.size());
  numbers.reserve(pairs.size());
  for (const Pair& one : pairs) {
    rows.push_back(static_cast<std::int64_t>(one.row));
    numbers.push_back(one.*second);
  }
}

rcbd_report report_of(const client::StepReport& told) {
  const auto number = [](std::uint64_t count) { return static_cast<std::int64_t>(count); };
  rcbd_report report = RCBD_REPORT;
  report.step = told.step;
  report.epoch = number(told.epoch);
  report.n = number(told.n);
  report.error_before = told.error_before.value_or(std::numeric_limits<double>::quiet_NaN());
  report.error = told.error;
  report.imbalance = told.imbalance;
  report.drifted = told.drifted ? number(*told.drifted) : -1;
  report.moved = number(told.moved);
  report.migrated = number(told.migrated);
  report.inserted = number(told.inserted);
  report.removed = number(told.removed);
  report.strangers = number(told.strangers);
  report.weights_as_zero = number(told.weights_as_zero);
  report.positions_step = told.positions_step.value_or(-1);
  report.bytes = number(told.bytes);
  report.scanned = number(told.scanned);
  report.searched = number(told.searched);
  report.rounds = number(told.rounds);
  report.reductions = number(told.reductions);
  report.seconds_receive = told.seconds_receive;
  report.seconds_exchange = told.seconds_exchange;
  report.seconds_search = told.seconds_search;
  report.seconds_migrate = told.seconds_migrate;
  report.seconds_total = told.seconds_total;
  report.parts = told.parts;
  report.axes_flipped = told.axes_flipped;
  report.repartitioned = told.repartitioned ? 1 : 0;
  report.sent = told.sent ? 1 : 0;
  report.reason = told.reason.c_str();
  report.way = told.way.c_str();
  report.json = told.json.c_str();
  return report;
}

// What is given where a function fails.
template <typename... Outputs>
void clear(Outputs*... outputs) {
  ((outputs != nullptr ? void(*outputs = {}) : void()), ...);
}

// The array of a result, with its length.
template <typename T>
Status give_array(const std::vector<T>& from, const T** to, std::int64_t* count) {
  if (to == nullptr || count == nullptr) return {Code::invalid_argument, "no room for an array: a null pointer"};
  *to = from.data();
  *count = static_cast<std::int64_t>(from.size());
  return {};
}

Status not_wanted(const char* option) {
  return {Code::not_found, "the step was not asked for this", fmt::format("set {} of its options", option)};
}

}  // namespace
}  // namespace rcb::c

using namespace rcb;  // NOLINT: the functions below are not of a namespace

void rcbd_result::take(client::StepResult&& step) {
  told = std::move(step);
  c::by_column(told.changes, &client::PartChange::part, changed_rows, changed_parts);
  c::by_column(told.leaving, &client::LeavingRow::to, leaving_rows, leaving_seats);
  told.changes = {};
  told.leaving = {};
}

void rcbd_op::run() {
  status = without_exceptions([&] {
    auto room = std::make_unique<rcbd_result>(options);  // before the step: memory may be short
    auto made = c::make_step(*scene, {positions, options}, &cancelled);
    if (!made) return made.status();
    room->take(std::move(*made));
    result = room.release();
    return Status();
  });
  scene->steps = false;
}

rcbd_op::~rcbd_op() {
  cancelled = true;
  if (begun) scene->client->worker.wait(*this, -1);
  if (result != nullptr) result->release();
}

int rcbd_step(rcbd_scene* scene, const rcbd_positions* positions, const rcbd_step_options* options, rcbd_result** to) {
  return c::call([&]() -> Status {
    if (to != nullptr) *to = nullptr;
    if (Status usable = c::check(scene); !usable) return usable;
    const auto ask = c::ask_of(*scene, positions, options);
    if (!ask) return ask.status();
    if (scene->steps) return c::busy_scene(scene->name);
    auto room = std::make_unique<rcbd_result>(ask->options);
    auto made = c::make_step(*scene, *ask, nullptr);
    if (!made || to == nullptr) return made.status();
    room->take(std::move(*made));
    *to = room.release();
    return {};
  });
}

int rcbd_step_begin(rcbd_scene* scene, const rcbd_positions* positions, const rcbd_step_options* options,
                    rcbd_op** to) {
  return c::call([&]() -> Status {
    if (to == nullptr) return {Code::invalid_argument, "no room for the op: a null pointer"};
    *to = nullptr;
    if (Status usable = c::check(scene); !usable) return usable;
    const auto ask = c::ask_of(*scene, positions, options);
    if (!ask) return ask.status();
    auto op = std::make_unique<rcbd_op>(*scene, ask->positions, ask->options);
    if (scene->steps.exchange(true)) return c::busy_scene(scene->name);
    if (Status begun = without_exceptions([&] { return scene->client->worker.add(*op); }); !begun) {
      scene->steps = false;
      return begun;
    }
    op->begun = true;
    *to = op.release();
    return {};
  });
}

int rcbd_wait(rcbd_op* op, double seconds, rcbd_result** to) {
  bool done = true;
  const int code = c::call([&]() -> Status {
    if (to != nullptr) *to = nullptr;
    if (Status usable = c::check(op); !usable) return usable;
    if (std::isnan(seconds)) return {Code::invalid_argument, "a wait of NaN seconds"};
    const c::Held<rcbd_op> held(*op);
    done = op->scene->client->worker.wait(*op, seconds);
    if (done && op->status) c::give(op->result, to);
    return done ? op->status : Status();
  });
  return done ? code : RCBD_PENDING;
}

void rcbd_cancel(rcbd_op* op) {
  if (c::usable(op)) op->cancelled = true;
}

int rcbd_result_report(rcbd_result* result, rcbd_report* report) {
  return c::call([&]() -> Status {
    if (Status usable = c::check(result); !usable) return usable;
    return c::write_struct(c::report_of(result->told.report), report, "RCBD_REPORT");
  });
}

int rcbd_result_parts(rcbd_result* result, const std::int32_t** part, std::int64_t* count) {
  return c::call([&]() -> Status {
    c::clear(part, count);
    if (Status usable = c::check(result); !usable) return usable;
    if (!result->has_parts) return c::not_wanted("want_parts");
    return c::give_array(result->told.parts, part, count);
  });
}

int rcbd_result_changed(rcbd_result* result, const std::int64_t** row, const std::int32_t** part, std::int64_t* count) {
  return c::call([&]() -> Status {
    c::clear(row, part, count);
    if (Status usable = c::check(result); !usable) return usable;
    if (!result->has_changed) return c::not_wanted("want_changed");
    if (Status given = c::give_array(result->changed_parts, part, count); !given) return given;
    return c::give_array(result->changed_rows, row, count);
  });
}

int rcbd_result_leaving(rcbd_result* result, const std::int64_t** row, const std::int32_t** seat, std::int64_t* count) {
  return c::call([&]() -> Status {
    c::clear(row, seat, count);
    if (Status usable = c::check(result); !usable) return usable;
    if (Status given = c::give_array(result->leaving_seats, seat, count); !given) return given;
    return c::give_array(result->leaving_rows, row, count);
  });
}
