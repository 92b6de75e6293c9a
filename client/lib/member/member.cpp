// MemberScene: keeps the seat over lost connections and pushes a member's contribution to a step: directly to the ranks
// if this and all other members know rank and slot of their particles, otherwise by ids.
#include "client/lib/member.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include <fmt/format.h>

#include "client/lib/member/member_places.hpp"
#include "client/lib/scene/changes.hpp"
#include "client/lib/scene/lost_scene.hpp"
#include "client/lib/scene/step_report.hpp"
#include "client/lib/session/content.hpp"
#include "client/lib/session/data_path.hpp"
#include "client/lib/session/push_source.hpp"
#include "client/lib/session/shared_arrays.hpp"
#include "common/base/axis_names.hpp"
#include "common/wire/field_reader.hpp"
#include "common/wire/limits.hpp"

namespace rcb::client {
namespace {

Status odd_answer(const std::string& why) {
  return {Code::protocol_error, fmt::format("answer to a member: {}", why),
          "use a client and a service of the same version"};
}

template <typename T>
Result<std::span<const T>> column(const Frame& answer, const char* name, const char* dtype) {
  const wire::Array* array = wire::find_array(answer.arrays, name);
  if (array == nullptr || array->dtype != dtype) return odd_answer(fmt::format("no array '{}' {}", name, dtype));
  return std::span(reinterpret_cast<const T*>(array->bytes.data()), array->bytes.size() / sizeof(T));
}

std::vector<Column> columns_of(const Positions& positions, std::span<const double> weights) {
  std::vector<Column> columns;
  for (std::size_t a = 0; a < static_cast<std::size_t>(positions.dims); ++a)
    columns.push_back(axis_column(positions, a));
  if (!weights.empty()) columns.push_back({"w", "<f8", weights.data(), 1});
  return columns;
}

}  // namespace

struct MemberScene::State {
  State(std::shared_ptr<Client::State> of, std::string scene, const MemberOptions& terms)
      : client(std::move(of)), name(std::move(scene)), options(terms) {
    if (const auto made = client->created.find(name); made != client->created.end()) known = made->second;
  }

  ~State() {
    if (connection_held()) arrays.unshare(session(), Deadline(kCloseSeconds));
    if (connection_held())
      static_cast<void>(session().call_once({{"command", "scene.close"}, {"scene", name}}, Retry(kCloseSeconds)));
  }

  Session& session() const { return *client->session; }
  bool connection_held() const { return session().connected() && connection == session().generation(); }

  Status open();
  // Takes the seat on the current connection, unless it is held already.
  Status take_seat(const Retry& retry);
  Status check(const Positions& positions, std::span<const std::int64_t> ids, const MemberStepOptions& step) const;
  // Whether to push directly to the ranks. All members decide alike, unless their Path options differ.
  Result<bool> wants_direct(const Deadline& deadline) const;
  // One attempt to push a step.
  Result<MemberStep> try_step(const Positions& positions, std::span<const std::int64_t> ids, std::int64_t step,
                              const MemberStepOptions& with, const Retry& retry);
  Result<Frame> push(const Positions& positions, std::span<const std::int64_t> ids, std::int64_t step,
                     const MemberStepOptions& with, const Retry& retry);
  // Asks for the answer to a step that was committed before the service was lost, when the member can't push that step
  // again. Errors: base_lost, if there is none.
  Result<Frame> ask_for_answer(std::int64_t step, const MemberStepOptions& with, const Retry& retry);
  // By the sockets of the ranks, or from memory that is shared with them. rows: by rank, of all particles.
  Result<Frame> push_to_ranks(wire::Json begin, const std::vector<std::vector<std::uint64_t>>& rows,
                              const Positions& positions, const MemberStepOptions& with, const std::string& what,
                              const Retry& retry);
  Result<Frame> push_by_sockets(wire::Json begin, std::uint64_t request, const EditFrames& edits,
                                const std::vector<std::vector<std::uint64_t>>& rows, const Positions& positions,
                                const MemberStepOptions& with, const std::string& what, const Deadline& deadline);
  static std::uint64_t content_of(const Positions& positions, std::span<const std::int64_t> ids,
                                  const MemberStepOptions& with);
  // Finds out whether the step of an earlier call was committed, before something else is pushed. Errors: stale_step.
  Status settle_unanswered(Retry& retry);
  Result<bool> settle_once(const Retry& retry);
  // The rows that moved; nullopt: all are to be sent.
  std::optional<std::span<const std::uint64_t>> moved_rows(const MemberStepOptions& with) const;
  Result<MemberStep> read(const Frame& answer, std::int64_t step, const MemberStepOptions& with, const Retry& retry);
  Status read_follow(const Frame& answer, const wire::Json& json, std::span<const std::int64_t> removed,
                     MemberStep& result);
  Status read_places(const Frame& answer, const wire::Json& json, std::span<const std::int64_t> removed,
                     const MemberStep& result);

  std::shared_ptr<Client::State> client;
  std::string name;
  MemberOptions options;
  KnownScene known;
  std::uint64_t connection = 0;  // the one that holds the seat
  std::uint64_t seat = 0;        // generation of the seat; 0: never had it
  int dims = 3;
  std::uint64_t n = 0;  // particles of the scene; 0: not known yet
  bool weights = false;
  bool lost = false;  // the service was restarted, and the scene has no positions yet
  std::optional<std::int64_t> last_step;
  // As in Scene::State: a step that may have been committed although its answer didn't come.
  std::optional<std::int64_t> unanswered;
  std::uint64_t unanswered_content = 0;
  bool unanswered_needed = false;
  std::uint64_t epoch = 0;  // after last_step
  // False if a step or new cuts came that this member was told nothing of. Then it can't name a step as the base of its
  // push, and brings all its particles.
  bool up_to_date = true;
  // After last_step, with follow:
  MemberPlaces places;
  wire::Json plan;
  bool pushing_directly = false;  // path of the current push
  bool pushing_few = false;       // particles, or none
  bool send_all = false;          // whatever has moved, in the current step
  SharedArrays arrays;
  bool share_unsupported = false;  // a rank, or this kernel, refused it
};

Status MemberScene::State::take_seat(const Retry& retry) {
  if (connection == session().generation()) return {};
  wire::Json request{
      {"scene", name}, {"member", options.member}, {"members", options.members}, {"follow", options.follow}};
  // The service may not have noticed yet that the previous connection was lost: a higher generation displaces it.
  if (seat > 0) request["generation"] = seat + 1;
  const std::string service_before = known.instance;
  const auto json = open_or_make_anew(session(), request, known, retry);
  if (!json) return json.status();
  const auto found = json->find("membership");
  if (found == json->end()) return odd_answer("the service knows no members");
  const auto generation = wire::integer_field(*found, "generation", 1, kLarge);
  wire::FieldReader fields(*json);
  const auto axes = static_cast<int>(fields.integer("dims", 1, 3));
  const std::int64_t step = fields.integer_or("step", 0, wire::kStepMax, -1);
  const std::uint64_t count = fields.particles("n");
  const auto epoch_now = static_cast<std::uint64_t>(fields.integer_or("epoch", 0, kLarge, 0));
  const bool has_weights = fields.flag("weights");
  fields.fail(generation.status());
  if (!fields.ok()) return odd_answer(fields.status().message());
  connection = session().generation();
  const bool known_before = seat > 0;
  seat = static_cast<std::uint64_t>(*generation);
  known.options = scene_options(*json);
  dims = axes;
  const bool other_service = known.instance != service_before;
  lost = step < 0 && (lost || (last_step && other_service));
  const auto step_now = step >= 0 ? std::optional(step) : std::nullopt;
  // A rebalance changes the epoch alone.
  if (known_before && (step_now != last_step || epoch_now != epoch || other_service)) {
    places.forget();
    up_to_date = false;
  }
  if (lost) return {};
  n = count;
  weights = has_weights;
  epoch = epoch_now;
  last_step = step_now;
  return {};
}

Status MemberScene::State::open() {
  Retry retry(options.deadline_seconds);
  const auto once = [&]() -> Result<bool> {
    if (Status status = take_seat(retry); !status) return status;
    return true;
  };
  const auto mend = [&](const Status& status) {
    // Not found: another member, which has created the scene and so knows its options, will create it again. Busy: the
    // service may not have noticed yet that our previous connection, which holds the seat, was lost.
    const bool scene_lost = status.code() == Code::not_found && session().restarted();
    const bool taken = status.code() == Code::busy && retry.failures() > 0;
    const std::string what =
        scene_lost ? fmt::format("scene '{}', which was lost, to be made anew", name) : status.message();
    return session().outlive() && (scene_lost || taken) && session().wait(retry, status, what).ok();
  };
  return session().retry_until_deadline(retry, once, mend).status();
}

Status MemberScene::State::check(const Positions& positions, std::span<const std::int64_t> ids,
                                 const MemberStepOptions& step) const {
  const auto wrong = [this](const std::string& message, std::string hint) {
    return Status(Code::invalid_argument, fmt::format("push to scene '{}': {}", name, message), std::move(hint));
  };
  if (positions.dims != dims)
    return wrong(fmt::format("positions of {} dimensions, the scene has {}", positions.dims, dims),
                 "create the scene with the positions' dims");
  if (positions.in_plan_order())
    return wrong("positions in the plan's order", "a member pushes its own particles by rows or axes");
  for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a)
    if (positions.count > 0 && (positions.single() ? positions.axis_f4[a] == nullptr : positions.axis[a] == nullptr))
      return wrong(fmt::format("no array for axis {}", kAxisNames[a]), "give one array an axis");
  if (positions.stride == 0) return wrong("a stride of 0", "a stride is at least 1");
  if (ids.size() != positions.count)
    return wrong(fmt::format("{} ids for {} particles", ids.size(), positions.count), "give one id a particle");
  if (!step.weights.empty() && step.weights.size() != positions.count)
    return wrong(fmt::format("{} weights for {} particles", step.weights.size(), positions.count),
                 "give one weight a particle, or none");
  for (const std::uint64_t row : step.moved.value_or(std::span<const std::uint64_t>()))
    if (row >= positions.count)
      return wrong(fmt::format("row {} moved, there are {}", row, positions.count), "rows count from 0");
  if (step.inserted != nullptr)
    // A member that has brought no particles yet may not know of the scene's weights.
    if (Status status = check_insertion(name, *step.inserted, positions, dims,
                                        weights || !step.weights.empty() || !step.inserted->weights.empty());
        !status)
      return status;
  if (step.step && *step.step < 0) return wrong(fmt::format("step {}", *step.step), "steps are numbered from 0");
  if (step.step_seconds && !(*step.step_seconds >= 0 && std::isfinite(*step.step_seconds)))
    return wrong(fmt::format("a step of {} seconds", *step.step_seconds), "give a finite number >= 0, or none");
  if (!(step.deadline_seconds > 0))
    return wrong(fmt::format("a deadline of {} seconds", step.deadline_seconds), "give a number above 0");
  return {};
}

std::uint64_t MemberScene::State::content_of(const Positions& positions, std::span<const std::int64_t> ids,
                                             const MemberStepOptions& with) {
  Content content;
  content.add(std::uint64_t{with.unmoved ? 1U : 0U});
  content.add(positions, nullptr);
  content.add(ids);
  content.add(with.weights);
  content.add(with.moved.value_or(std::span<const std::uint64_t>()));
  content.add(with.removed);
  content.add(with.inserted);
  return content.value();
}

Status MemberScene::State::settle_unanswered(Retry& retry) {
  const auto once = [&] { return settle_once(retry); };
  const auto needed = session().retry_until_deadline(retry, once, [](const Status&) { return false; });
  if (!needed) return needed.status();
  if (*needed)
    return Status(Code::stale_step,
                  fmt::format("step {} of scene '{}' was committed after all, although its answer didn't come",
                              *unanswered, name),
                  "push the same once more: the answer says which particles there are now");
  unanswered.reset();
  return {};
}

// Whether the step was committed, and its answer is needed.
Result<bool> MemberScene::State::settle_once(const Retry& retry) {
  if (Status status = take_seat(retry); !status) return status;
  if (lost) return false;
  const auto json = described(session(), {{"command", "scene.show"}, {"scene", name}}, retry);
  if (!json) return json.status();
  wire::FieldReader fields(*json);
  const std::int64_t step = fields.integer_or("step", 0, wire::kStepMax, -1);
  const std::uint64_t count = fields.particles("n");
  const auto epoch_now = static_cast<std::uint64_t>(fields.integer_or("epoch", 0, kLarge, 0));
  if (!fields.ok()) return odd_answer(fields.status().message());
  if (step == *unanswered && unanswered_needed) return true;
  const auto step_now = step >= 0 ? std::optional(step) : std::nullopt;
  if (step_now == last_step) return false;
  places.forget();
  up_to_date = false;
  last_step = step_now;
  n = count;
  epoch = epoch_now;
  return false;
}

Result<bool> MemberScene::State::wants_direct(const Deadline& deadline) const {
  const Path path = session().path();
  const bool large = n == 0 || n * static_cast<std::uint64_t>(dims) * sizeof(double) >= kDirectBytesMin;
  if (!options.follow || path == Path::gateway || (path == Path::automatic && !large)) return false;
  if (session().data(deadline) != nullptr) return true;
  if (path != Path::direct) return false;
  return session().no_data();
}

std::optional<std::span<const std::uint64_t>> MemberScene::State::moved_rows(const MemberStepOptions& with) const {
  if (!last_step || !up_to_date || send_all || !with.weights.empty()) return std::nullopt;
  return with.unmoved ? std::span<const std::uint64_t>() : with.moved;
}

Result<Frame> MemberScene::State::push_to_ranks(wire::Json begin, const std::vector<std::vector<std::uint64_t>>& rows,
                                                const Positions& positions, const MemberStepOptions& with,
                                                const std::string& what, const Retry& retry) {
  begin["order"] = "plan";
  begin["plan"] = plan;
  begin["epoch"] = epoch;
  begin["base_step"] = *last_step;
  const std::uint64_t request = session().next_request();
  const EditFrames edits = edit_frames(begin, request, with.removed, with.inserted, dims);
  begin["slices"] = edits.count;
  begin["counts"] = wire::Json::array();
  for (const auto& mine : rows) begin["counts"].push_back(mine.size());
  const Path path = session().path();
  if ((path == Path::automatic || path == Path::shared) && !share_unsupported && begin.at("moved") == "all" &&
      positions.count > 0 && session().can_share(retry.deadline())) {
    const RankRows lists(rows.begin(), rows.end());
    auto memory =
        arrays.describe(session(), {.positions = positions, .weights = with.weights, .rows = lists}, retry.deadline());
    if (memory) {
      begin["path"] = "shared";
      begin["memory"] = std::move(*memory);
      return session().exchange_frames(request, request_frame(request, begin) + edits.bytes, what, retry.deadline());
    }
    if (memory.status().code() == Code::aborted) return memory.status();
    share_unsupported = true;
  }
  return push_by_sockets(std::move(begin), request, edits, rows, positions, with, what, retry.deadline());
}

Result<Frame> MemberScene::State::push_by_sockets(wire::Json begin, std::uint64_t request, const EditFrames& edits,
                                                  const std::vector<std::vector<std::uint64_t>>& rows,
                                                  const Positions& positions, const MemberStepOptions& with,
                                                  const std::string& what, const Deadline& deadline) {
  begin["path"] = "direct";
  std::vector<Column> columns = columns_of(positions, with.weights);
  RankRows of_rank;
  std::vector<MemberPlaces::Few> few;
  std::vector<const void*> slots;  // by rank
  if (const auto moved = moved_rows(with)) {
    few = places.select(*moved);
    const bool none = moved->empty();
    for (std::size_t rank = 0; rank < few.size(); ++rank) {
      if (!none) begin["counts"][rank] = few[rank].rows.size();
      of_rank.emplace_back(few[rank].rows);
      slots.push_back(few[rank].slots.data());
    }
    columns.push_back({"slot", "<u8", nullptr, 1, slots.data()});
  } else {
    of_rank.assign(rows.begin(), rows.end());
  }
  wire::Json slice{{"command", "push.slice"}};
  for (const char* field : {"scene", "session", "step", "attempt", "plan"}) slice[field] = begin.at(field);
  return session().exchange_directly(request, request_frame(request, begin) + edits.bytes, slice, of_rank, columns,
                                     what, deadline);
}

Result<Frame> MemberScene::State::push(const Positions& positions, std::span<const std::int64_t> ids, std::int64_t step,
                                       const MemberStepOptions& with, const Retry& retry) {
  const Deadline& deadline = retry.deadline();
  const auto direct = wants_direct(deadline);
  if (!direct) return direct.status();
  const auto* rows = *direct && last_step ? places.rows(ids) : nullptr;
  pushing_directly = rows != nullptr;
  // Only a push of all particles by ids tells their places, which the direct path needs.
  send_all = send_all || (*direct && !pushing_directly);
  const auto moved = moved_rows(with);
  pushing_few = moved.has_value();
  const std::size_t inserted = with.inserted == nullptr ? 0 : with.inserted->positions.count;
  const bool single = positions.count > 0 || inserted == 0 ? positions.single() : with.inserted->positions.single();
  wire::Json begin{{"command", "push.begin"},
                   {"scene", name},
                   {"session", session().number()},
                   {"step", step},
                   {"attempt", session().next_attempt()},
                   {"n", positions.count},
                   {"order", "id"},
                   {"plan", nullptr},
                   {"dtype", single ? "<f4" : "<f8"},
                   {"weights", !with.weights.empty()},
                   {"ids", !pushing_directly && !pushing_few},
                   {"changes", with.want_changes},
                   {"places", *direct},
                   {"base_step", pushing_few ? wire::Json(*last_step) : wire::Json()},
                   {"moved", !moved           ? "all"
                             : moved->empty() ? "none"
                                              : "some"},
                   {"inserted", inserted},
                   {"inserted_ids", inserted > 0 && !with.inserted->ids.empty()},
                   {"removed", with.removed.size()},
                   {"deadline_seconds", retry.seconds_left()}};
  if (with.step_seconds) begin["step_seconds"] = *with.step_seconds;
  const std::string what = fmt::format("push of step {} to scene '{}'", step, name);
  if (pushing_directly) return push_to_ranks(std::move(begin), *rows, positions, with, what, retry);
  std::vector<Column> columns = columns_of(positions, with.weights);
  columns.push_back({"id", "<i8", ids.data(), 1});
  // One slice, its rows in their order.
  const layout::Layout all = layout::Layout::blocks(moved ? 0 : positions.count, 1, {});
  if (moved) begin["epoch"] = epoch;
  if (moved && !moved->empty()) begin["counts"] = {moved->size()};
  const std::uint64_t request = session().next_request();
  const EditFrames edits = edit_frames(begin, request, with.removed, with.inserted, dims);
  PushSource source(begin, request, moved ? RankRows{*moved} : all_rows(all), std::move(columns), edits.bytes,
                    edits.count);
  return session().exchange(request, source, what, deadline);
}

Result<Frame> MemberScene::State::ask_for_answer(std::int64_t step, const MemberStepOptions& with, const Retry& retry) {
  auto answer = session().call_once({{"command", "push.begin"},
                                     {"scene", name},
                                     {"session", session().number()},
                                     {"step", step},
                                     {"attempt", session().next_attempt()},
                                     {"n", 0},
                                     {"slices", 0},
                                     {"order", "id"},
                                     {"ids", true},
                                     {"moved", "none"},
                                     {"changes", with.want_changes}},
                                    retry);
  if (answer || !session().connected()) return answer;
  return Status(Code::base_lost,
                fmt::format("the service at {} was started again and has lost scene '{}', which had weights",
                            session().endpoint(), name),
                "push this step with weights; the other members are told the same");
}

Result<MemberStep> MemberScene::State::read(const Frame& answer, std::int64_t step, const MemberStepOptions& with,
                                            const Retry& retry) {
  const auto json = answer.json();
  if (!json) return json.status();
  const auto found = json->find("report");
  if (found == json->end()) return odd_answer("no 'report'");
  auto report = read_report(*found);
  if (!report) return report.status();
  const bool epoch_follows = !last_step || lost || report->epoch == epoch + (report->repartitioned ? 1U : 0U);
  if (!epoch_follows) refresh_options(session(), name, known, retry);
  if (report->parts > 0) known.options["parts"] = report->parts;
  epoch = report->epoch;
  last_step = std::max(step, last_step.value_or(step));
  up_to_date = true;
  weights = weights || !with.weights.empty();
  const auto repeated = wire::bool_field_or(*json, "repeated", false);
  lost = lost && repeated && *repeated;  // the answer is one that was kept by the service before the restart
  MemberStep result;
  result.report = std::move(*report);
  if (with.want_changes) {
    const auto id = column<std::int64_t>(answer, "changed_id", "<i8");
    const auto part = column<std::int32_t>(answer, "changed_part", "<i4");
    if (!id || !part || id->size() != part->size()) return odd_answer("its changes are not as the protocol says");
    for (std::size_t i = 0; i < id->size(); ++i) result.changes.push_back({(*id)[i], (*part)[i]});
  }
  n = result.report.n;
  if (with.inserted != nullptr && with.inserted->positions.count > 0) {
    const auto id = column<std::int64_t>(answer, "inserted_id", "<i8");
    if (!id || id->size() != with.inserted->positions.count) return odd_answer("not the ids of what was inserted");
    result.inserted_ids.assign(id->begin(), id->end());
  }
  if (!options.follow) return result;
  if (Status status = read_follow(answer, *json, with.removed, result); !status) return status;
  return result;
}

Status MemberScene::State::read_follow(const Frame& answer, const wire::Json& json,
                                       std::span<const std::int64_t> removed, MemberStep& result) {
  const auto leave_id = column<std::int64_t>(answer, "leave_id", "<i8");
  const auto leave_to = column<std::int32_t>(answer, "leave_to", "<i4");
  const auto enter_id = column<std::int64_t>(answer, "enter_id", "<i8");
  const auto enter_from = column<std::int32_t>(answer, "enter_from", "<i4");
  const auto enter_part = column<std::int32_t>(answer, "enter_part", "<i4");
  if (!leave_id || !leave_to || !enter_id || !enter_from || !enter_part || leave_id->size() != leave_to->size() ||
      enter_id->size() != enter_from->size() || enter_id->size() != enter_part->size())
    return odd_answer("what leaves and enters is not as the protocol says");
  const auto is_member = [this](std::int32_t k) { return k >= 0 && k < options.members; };
  if (!std::all_of(leave_to->begin(), leave_to->end(), is_member) ||
      !std::all_of(enter_from->begin(), enter_from->end(), is_member))
    return odd_answer("it names a member that there isn't");
  for (std::size_t i = 0; i < leave_id->size(); ++i) result.leave.push_back({(*leave_id)[i], (*leave_to)[i]});
  for (std::size_t i = 0; i < enter_id->size(); ++i)
    result.enter.push_back({(*enter_id)[i], (*enter_from)[i], (*enter_part)[i]});
  return read_places(answer, json, removed, result);
}

// Keeps the places of the particles if the answer tells all of them; then the next push goes directly to the ranks.
Status MemberScene::State::read_places(const Frame& answer, const wire::Json& json,
                                       std::span<const std::int64_t> removed, const MemberStep& result) {
  const auto repeated = wire::bool_field_or(json, "repeated", false);
  // A repeated answer tells changes relative to a state that this member may not have seen.
  if (wire::find_array(answer.arrays, "place_id") == nullptr || !repeated || *repeated || !json.contains("plan") ||
      n >= MemberPlaces::kSlotsMax) {
    places.forget();
    return {};
  }
  const auto id = column<std::int64_t>(answer, "place_id", "<i8");
  const auto rank = column<std::int32_t>(answer, "place_rank", "<i4");
  const auto slot = column<std::uint64_t>(answer, "place_slot", "<u8");
  const auto is_rank = [this](std::int32_t r) { return r >= 0 && r < session().ranks(); };
  const auto is_slot = [this](std::uint64_t s) { return s < n; };
  if (!id || !rank || !slot || id->size() != rank->size() || id->size() != slot->size() ||
      !std::all_of(rank->begin(), rank->end(), is_rank) || !std::all_of(slot->begin(), slot->end(), is_slot))
    return odd_answer("its places are not as the protocol says");
  wire::FieldReader fields(json);
  const std::string of = fields.text_or("places", 16, pushing_directly ? "changed" : "all");
  std::vector<std::int64_t> left(removed.begin(), removed.end());
  for (const Leaving& leaving : result.leave) left.push_back(leaving.id);
  std::sort(left.begin(), left.end());
  if (of == "all")
    places.take_all({*id, *rank, *slot}, session().ranks());
  else if (pushing_directly)
    places.change(left, {*id, *rank, *slot});
  else
    places.forget();
  plan = json.at("plan");
  return {};
}

MemberScene::MemberScene(std::unique_ptr<State> state) : state_(std::move(state)) {}
MemberScene::MemberScene(MemberScene&&) noexcept = default;
MemberScene& MemberScene::operator=(MemberScene&&) noexcept = default;
MemberScene::~MemberScene() = default;
Result<std::span<double>> MemberScene::position_rows(std::size_t count) {
  return state_->arrays.rows<double>(count, state_->dims);
}
Result<std::vector<std::span<double>>> MemberScene::position_axes(std::size_t count) {
  return state_->arrays.axes<double>(count, state_->dims);
}
Result<std::span<float>> MemberScene::position_rows_f4(std::size_t count) {
  return state_->arrays.rows<float>(count, state_->dims);
}
Result<std::vector<std::span<float>>> MemberScene::position_axes_f4(std::size_t count) {
  return state_->arrays.axes<float>(count, state_->dims);
}
std::optional<std::int64_t> MemberScene::last_step() const { return state_->last_step; }
std::uint64_t MemberScene::generation() const { return state_->seat; }

Result<MemberScene> MemberScene::open(Client& client, const std::string& name, const MemberOptions& options) {
  if (Status status = wire::check_scene_name(name); !status) return status;
  auto state = std::make_unique<State>(client.state_, name, options);
  if (Status status = state->open(); !status) return status;
  return MemberScene(std::move(state));
}

Result<MemberStep> MemberScene::State::try_step(const Positions& positions, std::span<const std::int64_t> ids,
                                                std::int64_t step, const MemberStepOptions& with, const Retry& retry) {
  pushing_directly = false;
  if (Status status = take_seat(retry); !status) return status;
  const bool lacks_weights = lost && weights && with.weights.empty() && positions.count > 0;
  const bool tried_before = std::exchange(unanswered, step) == step;
  const auto answer = lacks_weights ? ask_for_answer(step, with, retry) : push(positions, ids, step, with, retry);
  if (!answer) {
    const Code code = answer.status().code();
    const bool unknown = code == Code::unavailable || code == Code::deadline_exceeded || code == Code::aborted;
    if (!unknown && !tried_before) unanswered.reset();
    return answer.status();
  }
  unanswered.reset();
  auto result = read(*answer, step, with, retry);
  if (!result) places.forget();  // the step is committed, but its changes aren't known
  return result;
}

Result<MemberStep> MemberScene::step(const Positions& positions, std::span<const std::int64_t> ids,
                                     const MemberStepOptions& options) {
  if (Status status = state_->check(positions, ids, options); !status) return status;
  Retry retry(options.deadline_seconds);
  std::optional<std::int64_t> step = options.step;
  if (const auto open = state_->unanswered) {
    if (step.value_or(*open) == *open && State::content_of(positions, ids, options) == state_->unanswered_content)
      step = open;
    else if (Status status = state_->settle_unanswered(retry); !status)
      return status;
  }
  if (!step && state_->last_step && *state_->last_step == wire::kStepMax)
    return Status(Code::invalid_argument, "there is no step number left");
  if (!step) step = state_->last_step ? *state_->last_step + 1 : 0;
  const bool first = !state_->last_step;
  state_->send_all = false;
  Session& session = state_->session();
  const auto once = [&] { return state_->try_step(positions, ids, *step, options, retry); };
  const auto mend = [&](const Status& status) {
    // The parts or the layout changed without this member knowing, or another member doesn't know them: push by ids.
    if (state_->pushing_directly && (status.code() == Code::stale_plan || status.code() == Code::base_lost)) {
      state_->places.forget();
      return true;
    }
    if (state_->pushing_few && status.code() == Code::base_lost) return state_->send_all = true;
    if (status.code() != Code::aborted) return false;
    // This member or another lost its connection. That one reconnects, and all members push again.
    const bool data_lost = session.data_lost();
    if (data_lost) state_->places.forget();
    state_->arrays.share_again();
    return (data_lost || session.outlive()) &&
           session.wait(retry, status, fmt::format("the members of scene '{}': {}", state_->name, status.message()))
               .ok();
  };
  auto result = session.retry_until_deadline(retry, once, mend);
  if (!result && state_->unanswered) {
    state_->unanswered_content = State::content_of(positions, ids, options);
    state_->unanswered_needed = first || options.inserted != nullptr || !options.removed.empty();
  }
  return result;
}

}  // namespace rcb::client
