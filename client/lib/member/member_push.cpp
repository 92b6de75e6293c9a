// Pushing a member's contribution: directly to the ranks if this and all other members know rank and slot of their
// particles, otherwise by ids.
#include <algorithm>

#include <fmt/format.h>

#include "client/lib/member/member_state.hpp"
#include "client/lib/session/data_path.hpp"
#include "client/lib/session/push_source.hpp"

namespace rcb::client {
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

bool MemberScene::State::mostly_here(const std::vector<std::vector<std::uint64_t>>& rows,
                                     const Positions& positions) const {
  std::size_t apart = 0;
  for (const int rank : session().ranks_apart()) apart += rows[static_cast<std::size_t>(rank)].size();
  return arrays.gave(positions) || 2 * apart <= positions.count || session().path() == Path::shared;
}

Result<Frame> MemberScene::State::push_to_ranks(wire::Json begin, const std::vector<std::vector<std::uint64_t>>& rows,
                                                const Positions& positions, const MemberStepOptions& with,
                                                const std::string& what, const Retry& retry) {
  begin["order"] = "plan";
  begin["plan"] = plan;
  begin["epoch"] = epoch;
  begin["base_step"] = *last_step;
  const std::uint64_t request = session().next_request();
  const EditFrames edits = edit_frames(begin, request, with.removed, with.inserted);
  begin["slices"] = edits.count;
  begin["counts"] = wire::Json::array();
  for (const auto& mine : rows) begin["counts"].push_back(mine.size());
  const Path path = session().path();
  if ((path == Path::automatic || path == Path::shared) && !share_unsupported && begin.at("moved") == "all" &&
      positions.count > 0 && session().can_share(retry.deadline()) && mostly_here(rows, positions)) {
    const RankRows lists(rows.begin(), rows.end());
    auto memory =
        arrays.describe(session(), {.positions = positions, .weights = with.weights, .rows = lists}, retry.deadline());
    if (memory) {
      begin["path"] = "shared";
      begin["memory"] = std::move(*memory);
      return session().exchange_shared(request, std::move(begin), edits.bytes, lists,
                                       columns_of(positions, with.weights), what, retry.deadline());
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
  return session().exchange_directly(request, request_frame(request, begin) + edits.bytes, slice_json(begin), of_rank,
                                     columns, what, deadline);
}

Result<Frame> MemberScene::State::push(const Positions& positions, std::span<const std::int64_t> ids, std::int64_t step,
                                       const MemberStepOptions& with, const Retry& retry) {
  const Deadline& deadline = retry.deadline();
  const auto direct = wants_direct(deadline);
  if (!direct) return direct.status();
  const auto* rows = *direct && last_step ? places.rows(ids) : nullptr;
  pushing_directly = rows != nullptr;
  // Only a push of all particles by ids tells their places, which the direct path needs, and tells the service whose a
  // change of parts is.
  send_all = send_all || !filled || (!pushing_directly && (*direct || with.want_changes));
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
                   {"weights", !with.weights.empty() || (!moved && weights && positions.count == 0)},
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
  if (!filled) begin["refill"] = true;
  if (with.step_seconds) begin["step_seconds"] = *with.step_seconds;
  if (uses_cuts(with)) begin["cuts_known"] = scene_cuts.known_json();
  const std::string what = fmt::format("push of step {} to scene '{}'", step, name);
  if (pushing_directly) return push_to_ranks(std::move(begin), *rows, positions, with, what, retry);
  std::vector<Column> columns = columns_of(positions, with.weights);
  columns.push_back({"id", "<i8", ids.data(), 1});
  // One slice, its rows in their order.
  const layout::Layout all = layout::Layout::blocks(moved ? 0 : positions.count, 1, {});
  if (moved) begin["epoch"] = epoch;
  if (moved && !moved->empty()) begin["counts"] = {moved->size()};
  const std::uint64_t request = session().next_request();
  const EditFrames edits = edit_frames(begin, request, with.removed, with.inserted);
  PushSource source(begin, request, moved ? RankRows{*moved} : all_rows(all), std::move(columns), edits.bytes,
                    edits.count);
  return session().exchange(request, source, what, deadline);
}

Status MemberScene::State::refill(const Positions& positions, std::span<const std::int64_t> ids,
                                  const MemberStepOptions& with, const Retry& retry) {
  if (weights && with.weights.empty() && positions.count > 0)
    return {Code::base_lost,
            fmt::format("the service at {} was started again, and its ranks hold no particles of scene '{}', which has "
                        "weights",
                        session().endpoint(), name),
            "push this step with weights; the other members are told the same"};
  MemberStepOptions all;
  all.weights = with.weights;
  const auto answer = push(positions, ids, *last_step, all, retry);
  if (!answer && answer.status().code() != Code::stale_step) return answer.status();  // stale: others were quicker
  filled = true;
  up_to_date = false;
  return {};
}

Result<Frame> MemberScene::State::ask_for_answer(std::int64_t step, const MemberStepOptions& with, const Retry& retry) {
  wire::Json begin{{"command", "push.begin"},
                   {"scene", name},
                   {"session", session().number()},
                   {"step", step},
                   {"attempt", session().next_attempt()},
                   {"n", 0},
                   {"slices", 0},
                   {"order", "id"},
                   {"moved", "none"}};
  if (uses_cuts(with)) begin["cuts_known"] = scene_cuts.known_json();
  return session().call_once(std::move(begin), retry);
}

}  // namespace rcb::client
