// A step of a when-needed scene: this member counts what it has; it pushes where the answer asks for positions, or
// another member pushes.
#include "client/lib/member/member_state.hpp"

namespace rcb::client {

bool MemberScene::State::can_count(const MemberStepOptions& with) const {
  const bool edits = !with.removed.empty() || (with.inserted != nullptr && with.inserted->positions.count > 0);
  return when_needed && last_step && filled && !edits && !with.want_changes && (!weights || !with.weights.empty());
}

Result<std::optional<Frame>> MemberScene::State::count(const Positions& positions, std::span<const std::int64_t> ids,
                                                       std::int64_t step, const MemberStepOptions& with,
                                                       const Retry& retry) {
  if (!can_count(with)) return std::optional<Frame>();
  return counting.ask({session(), name, incarnation, step, last_step, with.step_seconds, true},
                      CountedRows{positions, ids, with.weights, weights, with.threads}, scene_cuts, retry);
}

}  // namespace rcb::client
