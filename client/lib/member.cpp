// MemberScene: the seat, kept over lost connections, and a member's share of a step: straight to the ranks where this
// member and all others know the places of what they hold, else by ids.
#include "client/lib/member.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "client/lib/data_path.hpp"
#include "client/lib/lost_scene.hpp"
#include "client/lib/member_places.hpp"
#include "client/lib/push_source.hpp"
#include "client/lib/step_report.hpp"
#include "common/wire/limits.hpp"

namespace rcb::client {
namespace {

constexpr double kCloseSeconds = 2;
constexpr std::int64_t kLarge = std::numeric_limits<std::int64_t>::max();
constexpr const char* kAxisNames[] = {"x", "y", "z"};

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

}  // namespace

struct MemberScene::State {
  State(std::shared_ptr<Client::State> of, std::string scene, const MemberOptions& terms)
      : client(std::move(of)), name(std::move(scene)), options(terms) {
    if (const auto made = client->created.find(name); made != client->created.end()) known = made->second;
  }

  ~State() {
    if (connection_held())
      static_cast<void>(session().call_once({{"command", "scene.close"}, {"scene", name}}, Retry(kCloseSeconds)));
  }

  Session& session() const { return *client->session; }
  bool connection_held() const { return session().connected() && connection == session().generation(); }

  Status open();
  // Has the seat on the connection that stands.
  Status sit(const Retry& retry);
  Status check(const Positions& positions, std::span<const std::int64_t> ids, const MemberStepOptions& step) const;
  // Whether pushes shall go straight to the ranks; all members decide alike, unless they are told other paths.
  Result<bool> wants_direct(const Deadline& deadline) const;
  // One try of a step.
  Result<MemberStep> try_step(const Positions& positions, std::span<const std::int64_t> ids, std::int64_t step,
                              const MemberStepOptions& with, const Retry& retry);
  Result<Frame> push(const Positions& positions, std::span<const std::int64_t> ids, std::int64_t step,
                     const MemberStepOptions& with, const Retry& retry);
  // The answer to a step that was committed before the service was lost, for a member that can't push it once more.
  // Errors: base_lost, where there is none.
  Result<Frame> ask_for_answer(std::int64_t step, const MemberStepOptions& with, const Retry& retry);
  Result<Frame> push_directly(wire::Json begin, const std::vector<std::vector<std::uint64_t>>& rows,
                              std::span<const Column> columns, const std::string& what, const Deadline& deadline);
  Result<MemberStep> read(const Frame& answer, std::int64_t step, const MemberStepOptions& with, const Retry& retry);
  Status read_follow(const Frame& answer, const wire::Json& json, MemberStep& result);
  Status read_places(const Frame& answer, const wire::Json& json, const MemberStep& result);

  std::shared_ptr<Client::State> client;
  std::string name;
  MemberOptions options;
  KnownScene known;
  std::uint64_t connection = 0;  // that holds the seat
  std::uint64_t seat = 0;        // its generation; 0: never had it
  int dims = 3;
  std::uint64_t n = 0;  // of the scene; 0: not known yet
  bool weights = false;
  bool lost = false;  // the service was started again, and the scene has no positions yet
  std::optional<std::int64_t> last_step;
  std::uint64_t epoch = 0;  // after last_step
  // After last_step, with follow:
  MemberPlaces places;
  wire::Json plan;
  bool directly = false;  // the push under way
};

Status MemberScene::State::sit(const Retry& retry) {
  if (connection == session().generation()) return {};
  wire::Json request{
      {"scene", name}, {"member", options.member}, {"members", options.members}, {"follow", options.follow}};
  // The service may not have noticed yet that the connection before was lost.
  if (seat > 0) request["generation"] = seat + 1;
  const std::string service_before = known.instance;
  const auto json = open_or_make_anew(session(), request, known, retry);
  if (!json) return json.status();
  const auto found = json->find("membership");
  if (found == json->end()) return odd_answer("the service knows no members");
  const auto generation = wire::integer_field(*found, "generation", 1, kLarge);
  const auto axes = wire::integer_field(*json, "dims", 1, 3);
  const auto step = wire::integer_field_or(*json, "step", 0, wire::kStepMax, -1);
  const auto count = wire::integer_field_or(*json, "n", 0, wire::kParticlesMax, 0);
  const auto epoch_now = wire::integer_field_or(*json, "epoch", 0, kLarge, 0);
  const auto has_weights = wire::bool_field_or(*json, "weights", false);
  for (const Status& status :
       {generation.status(), axes.status(), step.status(), count.status(), epoch_now.status(), has_weights.status()})
    if (!status) return odd_answer(status.message());
  connection = session().generation();
  seat = static_cast<std::uint64_t>(*generation);
  known.options = scene_options(*json);
  dims = static_cast<int>(*axes);
  const bool other_service = known.instance != service_before;
  lost = *step < 0 && (lost || (last_step && other_service));
  const auto step_now = *step >= 0 ? std::optional(*step) : std::nullopt;
  if (step_now != last_step || other_service) places.forget();
  if (lost) return {};
  n = static_cast<std::uint64_t>(*count);
  weights = *has_weights;
  epoch = static_cast<std::uint64_t>(*epoch_now);
  last_step = step_now;
  return {};
}

Status MemberScene::State::open() {
  Retry retry(options.deadline_seconds);
  const auto once = [&]() -> Result<bool> {
    if (Status status = sit(retry); !status) return status;
    return true;
  };
  const auto mend = [&](const Status& status) {
    // Another member knows the scene's options, since it has made it; and the seat may be that of the connection
    // before.
    const bool scene_lost = status.code() == Code::not_found && session().restarted();
    const bool taken = status.code() == Code::busy && retry.failures() > 0;
    const std::string what =
        scene_lost ? fmt::format("scene '{}', which was lost, to be made anew", name) : status.message();
    return session().outlive() && (scene_lost || taken) && session().wait(retry, status, what).ok();
  };
  return session().persist(retry, once, mend).status();
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
  if (step.step && *step.step < 0) return wrong(fmt::format("step {}", *step.step), "steps are numbered from 0");
  if (step.step_seconds && !(*step.step_seconds >= 0 && std::isfinite(*step.step_seconds)))
    return wrong(fmt::format("a step of {} seconds", *step.step_seconds), "give a finite number >= 0, or none");
  if (!(step.deadline_seconds > 0))
    return wrong(fmt::format("a deadline of {} seconds", step.deadline_seconds), "give a number above 0");
  return {};
}

Result<bool> MemberScene::State::wants_direct(const Deadline& deadline) const {
  const Path path = session().path();
  const bool large = n == 0 || n * static_cast<std::uint64_t>(dims) * sizeof(double) >= kDirectBytesMin;
  if (!options.follow || path == Path::gateway || (path == Path::automatic && !large)) return false;
  if (session().data(deadline) != nullptr) return true;
  if (path == Path::automatic) return false;
  return Status(Code::unavailable, fmt::format("{} has no direct path to its ranks", session().endpoint()),
                "leave the path to the library, or start the service without --gateway-only");
}

Result<Frame> MemberScene::State::push_directly(wire::Json begin, const std::vector<std::vector<std::uint64_t>>& rows,
                                                std::span<const Column> columns, const std::string& what,
                                                const Deadline& deadline) {
  begin["command"] = "push.begin";
  begin["path"] = "direct";
  begin["order"] = "plan";
  begin["plan"] = plan;
  begin["epoch"] = epoch;
  begin["base_step"] = *last_step;
  begin["slices"] = 0;
  begin["counts"] = wire::Json::array();
  const bool none = begin.at("moved") == "none";
  RankRows of_rank;
  for (const auto& mine : rows) {
    begin["counts"].push_back(mine.size());
    of_rank.push_back(none ? std::span<const std::uint64_t>() : mine);
  }
  wire::Json slice{{"command", "push.slice"}};
  for (const char* field : {"scene", "session", "step", "attempt", "plan"}) slice[field] = begin.at(field);
  wire::FrameHeader header;
  header.request = session().next_request();
  return session().exchange_directly(header.request, wire::encode_frame(header, wire::dump_json(begin)), slice, of_rank,
                                     columns, what, deadline);
}

Result<Frame> MemberScene::State::push(const Positions& positions, std::span<const std::int64_t> ids, std::int64_t step,
                                       const MemberStepOptions& with, const Retry& retry) {
  const Deadline& deadline = retry.deadline();
  const auto direct = wants_direct(deadline);
  if (!direct) return direct.status();
  const auto* rows = *direct && last_step ? places.rows(ids) : nullptr;
  directly = rows != nullptr;
  wire::Json begin{{"scene", name},
                   {"session", session().number()},
                   {"step", step},
                   {"attempt", session().next_attempt()},
                   {"n", positions.count},
                   {"order", "id"},
                   {"plan", nullptr},
                   {"dtype", positions.single() ? "<f4" : "<f8"},
                   {"weights", !with.weights.empty()},
                   {"ids", !directly},
                   {"changes", with.want_changes},
                   {"places", *direct},
                   {"moved", directly && with.unmoved && with.weights.empty() ? "none" : "all"},
                   {"deadline_seconds", retry.seconds_left()}};
  if (with.step_seconds) begin["step_seconds"] = *with.step_seconds;
  std::vector<Column> columns;
  for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a) columns.push_back(axis_column(positions, a));
  if (!with.weights.empty()) columns.push_back({"w", "<f8", with.weights.data(), 1});
  const std::string what = fmt::format("push of step {} to scene '{}'", step, name);
  if (directly) return push_directly(std::move(begin), *rows, columns, what, deadline);
  columns.push_back({"id", "<i8", ids.data(), 1});
  // One slice with all rows, as they are.
  const plan::Plan all = plan::Plan::blocks(positions.count, 1, {});
  const std::uint64_t request = session().next_request();
  PushSource source(begin, request, all_rows(all), std::move(columns));
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
  weights = weights || !with.weights.empty();
  const auto repeated = wire::bool_field_or(*json, "repeated", false);
  lost = lost && repeated && *repeated;  // an answer that a service before this one has left
  MemberStep result;
  result.report = std::move(*report);
  if (with.want_changes) {
    const auto id = column<std::int64_t>(answer, "changed_id", "<i8");
    const auto part = column<std::int32_t>(answer, "changed_part", "<i4");
    if (!id || !part || id->size() != part->size()) return odd_answer("its changes are not as the protocol says");
    for (std::size_t i = 0; i < id->size(); ++i) result.changes.push_back({(*id)[i], (*part)[i]});
  }
  n = result.report.n;
  if (!options.follow) return result;
  if (Status status = read_follow(answer, *json, result); !status) return status;
  return result;
}

Status MemberScene::State::read_follow(const Frame& answer, const wire::Json& json, MemberStep& result) {
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
  return read_places(answer, json, result);
}

// Where the answer tells all that is needed the next push goes straight to the ranks.
Status MemberScene::State::read_places(const Frame& answer, const wire::Json& json, const MemberStep& result) {
  const auto repeated = wire::bool_field_or(json, "repeated", false);
  // That of a push that this one repeats tells changes from what nobody may have learnt.
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
  std::vector<std::int64_t> left;
  for (const Leaving& leaving : result.leave) left.push_back(leaving.id);
  if (directly)
    places.change(left, {*id, *rank, *slot});
  else
    places.take_all({*id, *rank, *slot}, session().ranks());
  plan = json.at("plan");
  return {};
}

MemberScene::MemberScene(std::unique_ptr<State> state) : state_(std::move(state)) {}
MemberScene::MemberScene(MemberScene&&) noexcept = default;
MemberScene& MemberScene::operator=(MemberScene&&) noexcept = default;
MemberScene::~MemberScene() = default;
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
  directly = false;
  if (Status status = sit(retry); !status) return status;
  const bool lacks_weights = lost && weights && with.weights.empty();
  const auto answer = lacks_weights ? ask_for_answer(step, with, retry) : push(positions, ids, step, with, retry);
  if (!answer) return answer.status();
  auto result = read(*answer, step, with, retry);
  if (!result) places.forget();  // the step is committed, and what it changed isn't known
  return result;
}

Result<MemberStep> MemberScene::step(const Positions& positions, std::span<const std::int64_t> ids,
                                     const MemberStepOptions& options) {
  std::optional<std::int64_t> step = options.step;
  if (!step && state_->last_step && *state_->last_step == wire::kStepMax)
    return Status(Code::invalid_argument, "there is no step number left");
  if (!step) step = state_->last_step ? *state_->last_step + 1 : 0;
  if (Status status = state_->check(positions, ids, options); !status) return status;
  Session& session = state_->session();
  Retry retry(options.deadline_seconds);
  const auto once = [&] { return state_->try_step(positions, ids, *step, options, retry); };
  const auto mend = [&](const Status& status) {
    // Parts or plan are others than this member knows, or another member doesn't know them: by ids, then.
    if (state_->directly && (status.code() == Code::stale_plan || status.code() == Code::base_lost)) {
      state_->places.forget();
      return true;
    }
    if (status.code() != Code::aborted) return false;
    // A connection went, of this member or another; whose it was comes back and pushes again, as all do.
    const bool data_lost = session.data_lost();
    if (data_lost) state_->places.forget();
    return (data_lost || session.outlive()) &&
           session.wait(retry, status, fmt::format("the members of scene '{}': {}", state_->name, status.message()))
               .ok();
  };
  return session.persist(retry, once, mend);
}

}  // namespace rcb::client
