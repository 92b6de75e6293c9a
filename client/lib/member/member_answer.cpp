// The answer to a member's push: the report, what leaves by the new cuts, and the places of the member's particles.
#include <algorithm>
#include <numeric>

#include "client/lib/member/member_state.hpp"
#include "client/lib/scene/step_report.hpp"
#include "common/wire/field_reader.hpp"

namespace rcb::client {
Result<MemberStep> MemberScene::State::read(const Frame& answer, const Positions& positions,
                                            std::span<const std::int64_t> ids, std::int64_t step,
                                            const MemberStepOptions& with, const Retry& retry) {
  const auto json = answer.json();
  if (!json) return json.status();
  const auto found = json->find("report");
  if (found == json->end()) return odd_member_answer("no 'report'");
  auto report = read_report(*found);
  if (!report) return report.status();
  const auto repeated = wire::bool_field(*json, "repeated");
  // The service was started again since the step: it tells no changes.
  const bool all_changed = with.want_changes && repeated && *repeated && !answer.array<std::int64_t>("changed_id");
  if (uses_cuts(with) || all_changed) {
    auto after = scene_cuts.after_step(answer, *json, session(), name, retry);
    if (!after) return parts_unknown(step, after.status());
    scene_cuts.known = std::move(*after);
  }
  unanswered.answered();
  counting.committed(step);
  epoch = report->epoch;
  last_step = std::max(step, last_step.value_or(step));
  up_to_date = true;
  weights = weights || !with.weights.empty();
  MemberStep result;
  result.report = std::move(*report);
  if (with.want_changes && !all_changed) {
    const auto id = answer.array<std::int64_t>("changed_id");
    const auto part = answer.array<std::int32_t>("changed_part");
    if (!id || !part || id->size() != part->size())
      return odd_member_answer("its changes are not as the protocol says");
    for (std::size_t i = 0; i < id->size(); ++i) result.changes.push_back({(*id)[i], (*part)[i]});
  }
  n = result.report.n;
  if (const std::size_t inserted = with.inserted == nullptr ? 0 : with.inserted->positions.count; inserted > 0) {
    result.inserted_ids.assign(with.inserted->ids.begin(), with.inserted->ids.end());
    const auto id = answer.array<std::int64_t>("inserted_id");
    if (const auto first = wire::integer_field_or(*json, "first_id", 0, kLarge, -1); first && *first >= 0) {
      result.inserted_ids.resize(inserted);
      std::iota(result.inserted_ids.begin(), result.inserted_ids.end(), *first);
    }
    if (id && id->size() == inserted) result.inserted_ids.assign(id->begin(), id->end());
    if (result.inserted_ids.size() != inserted) return odd_member_answer("not the ids of what was inserted");
  }
  if (!options.follow && !with.want_parts && !all_changed) return result;
  if (Status status = classify(positions, ids, with, result); !status) return parts_unknown(step, status);
  for (std::size_t row = 0; all_changed && row < ids.size(); ++row)
    result.changes.push_back({ids[row], result.parts[row]});
  std::ranges::sort(result.changes, {}, &MemberChange::id);
  if (!with.want_parts) result.parts.clear();
  if (!options.follow) return result;
  std::vector<std::int64_t> left(with.removed.begin(), with.removed.end());
  for (const LeavingRow& one : result.leaving)
    left.push_back(one.row < ids.size() ? ids[one.row] : result.inserted_ids[one.row - ids.size()]);
  if (Status status = read_places(answer, *json, std::move(left)); !status) return status;
  return result;
}

Status MemberScene::State::classify(const Positions& positions, std::span<const std::int64_t> ids,
                                    const MemberStepOptions& with, MemberStep& result) const {
  result.parts.resize(positions.count + result.inserted_ids.size());
  const auto [pushed, inserted] =
      std::pair(std::span(result.parts).first(positions.count), std::span(result.parts).subspan(positions.count));
  if (counting.holds(last_step, *scene_cuts.known))
    std::ranges::copy(counting.parts(), pushed.begin());
  else if (Status status = scene_cuts.known->owner(positions, {.ids = ids, .threads = with.threads}, pushed); !status)
    return status;
  if (!inserted.empty())
    if (Status status = scene_cuts.known->owner(with.inserted->positions,
                                                {.ids = result.inserted_ids, .threads = with.threads}, inserted);
        !status)
      return status;
  std::vector<std::int64_t> removed(with.removed.begin(), with.removed.end());
  std::sort(removed.begin(), removed.end());
  std::int32_t part = -1;  // of the row before
  int to = options.member;
  for (std::size_t row = 0; options.follow && row < result.parts.size(); ++row) {
    if (std::exchange(part, result.parts[row]) != result.parts[row])
      to = cuts::seat_of_part(result.parts[row], scene_cuts.known->parts(), options.members);
    if (to == options.member) continue;
    if (row >= ids.size() || !std::binary_search(removed.begin(), removed.end(), ids[row]))
      result.leaving.push_back({row, to});
  }
  return {};
}

Status MemberScene::State::read_places(const Frame& answer, const wire::Json& json, std::vector<std::int64_t> left) {
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
