// The answer to a member's push: the report, what leaves and enters, and the places of the member's particles.
#include <algorithm>

#include "client/lib/member/member_state.hpp"
#include "client/lib/scene/step_report.hpp"
#include "common/wire/field_reader.hpp"

namespace rcb::client {
Result<MemberStep> MemberScene::State::read(const Frame& answer, std::int64_t step, const MemberStepOptions& with,
                                            const Retry& retry) {
  const auto json = answer.json();
  if (!json) return json.status();
  const auto found = json->find("report");
  if (found == json->end()) return odd_member_answer("no 'report'");
  auto report = read_report(*found);
  if (!report) return report.status();
  const auto repeated = wire::bool_field(*json, "repeated");
  const bool still_lost = lost && repeated && *repeated;  // it is one that was kept by the service before the restart
  if (uses_cuts(with)) {
    auto after = scene_cuts.after_step(answer, *json, session(), name, retry);
    if (!after) return parts_unknown(step, after.status());
    scene_cuts.known = std::move(*after);
  } else if (lost && !still_lost) {
    scene_cuts.known.reset();
  }
  unanswered.answered();
  const bool epoch_follows = !last_step || lost || report->epoch == epoch + (report->repartitioned ? 1U : 0U);
  if (!epoch_follows) refresh_options(session(), name, known, retry);
  if (report->parts > 0) known.options["parts"] = report->parts;
  epoch = report->epoch;
  last_step = std::max(step, last_step.value_or(step));
  up_to_date = true;
  weights = weights || !with.weights.empty();
  lost = still_lost;
  MemberStep result;
  result.report = std::move(*report);
  if (with.want_changes) {
    const auto id = answer.array<std::int64_t>("changed_id");
    const auto part = answer.array<std::int32_t>("changed_part");
    if (!id || !part || id->size() != part->size())
      return odd_member_answer("its changes are not as the protocol says");
    for (std::size_t i = 0; i < id->size(); ++i) result.changes.push_back({(*id)[i], (*part)[i]});
  }
  n = result.report.n;
  if (with.inserted != nullptr && with.inserted->positions.count > 0) {
    const auto id = answer.array<std::int64_t>("inserted_id");
    if (!id || id->size() != with.inserted->positions.count)
      return odd_member_answer("not the ids of what was inserted");
    result.inserted_ids.assign(id->begin(), id->end());
  }
  if (!options.follow) return result;
  if (Status status = read_follow(answer, *json, with.removed, result); !status) return status;
  return result;
}

Status MemberScene::State::classify(const Positions& positions, std::span<const std::int64_t> ids,
                                    const MemberStepOptions& with, MemberStep& result) const {
  result.parts.resize(positions.count);
  if (Status status = scene_cuts.known->owner(positions, {.ids = ids, .threads = with.threads}, result.parts); !status)
    return status;
  std::vector<std::int64_t> removed(with.removed.begin(), with.removed.end());
  std::sort(removed.begin(), removed.end());
  std::int32_t part = -1;  // of the row before
  int to = options.member;
  for (std::size_t row = 0; options.follow && row < positions.count; ++row) {
    if (std::exchange(part, result.parts[row]) != result.parts[row])
      to = cuts::seat_of_part(result.parts[row], scene_cuts.known->parts(), options.members);
    if (to != options.member && !std::binary_search(removed.begin(), removed.end(), ids[row]))
      result.leaving.push_back({row, to});
  }
  if (!with.want_parts) result.parts.clear();
  return {};
}

Status MemberScene::State::read_follow(const Frame& answer, const wire::Json& json,
                                       std::span<const std::int64_t> removed, MemberStep& result) {
  const auto leave_id = answer.array<std::int64_t>("leave_id");
  const auto leave_to = answer.array<std::int32_t>("leave_to");
  const auto enter_id = answer.array<std::int64_t>("enter_id");
  const auto enter_from = answer.array<std::int32_t>("enter_from");
  const auto enter_part = answer.array<std::int32_t>("enter_part");
  if (!leave_id || !leave_to || !enter_id || !enter_from || !enter_part || leave_id->size() != leave_to->size() ||
      enter_id->size() != enter_from->size() || enter_id->size() != enter_part->size())
    return odd_member_answer("what leaves and enters is not as the protocol says");
  const auto is_member = [this](std::int32_t k) { return k >= 0 && k < options.members; };
  if (!std::all_of(leave_to->begin(), leave_to->end(), is_member) ||
      !std::all_of(enter_from->begin(), enter_from->end(), is_member))
    return odd_member_answer("it names a member that there isn't");
  for (std::size_t i = 0; i < leave_id->size(); ++i) result.leave.push_back({(*leave_id)[i], (*leave_to)[i]});
  for (std::size_t i = 0; i < enter_id->size(); ++i)
    result.enter.push_back({(*enter_id)[i], (*enter_from)[i], (*enter_part)[i]});
  held = pushed;
  if (held) {
    for (const std::int64_t id : removed) held->take(id);
    for (const std::int64_t id : result.inserted_ids) held->add(id);
    for (const Leaving& leaving : result.leave) held->take(leaving.id);
    for (const Entering& entering : result.enter) held->add(entering.id);
  }
  return read_places(answer, json, removed, result);
}

// Keeps the places of the particles if the answer tells all of them; then the next push goes directly to the ranks.
Status MemberScene::State::read_places(const Frame& answer, const wire::Json& json,
                                       std::span<const std::int64_t> removed, const MemberStep& result) {
  const auto repeated = wire::bool_field(json, "repeated");
  // A repeated answer tells changes relative to a state that this member may not have seen.
  if (wire::find_array(answer.arrays, "place_id") == nullptr || !repeated || *repeated || !json.contains("plan") ||
      n >= MemberPlaces::kSlotsMax) {
    places.forget();
    return {};
  }
  const auto id = answer.array<std::int64_t>("place_id");
  const auto rank = answer.array<std::int32_t>("place_rank");
  const auto slot = answer.array<std::uint64_t>("place_slot");
  const auto is_rank = [this](std::int32_t r) { return r >= 0 && r < session().ranks(); };
  const auto is_slot = [this](std::uint64_t s) { return s < n; };
  if (!id || !rank || !slot || id->size() != rank->size() || id->size() != slot->size() ||
      !std::all_of(rank->begin(), rank->end(), is_rank) || !std::all_of(slot->begin(), slot->end(), is_slot))
    return odd_member_answer("its places are not as the protocol says");
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

}  // namespace rcb::client
