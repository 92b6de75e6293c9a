// A step of a when-needed scene: this member counts what it has; it pushes where the answer asks for positions, or
// another member pushes.
#include <fmt/format.h>

#include "client/lib/member/member_state.hpp"
#include "common/wire/frame.hpp"

namespace rcb::client {
namespace {

std::string fault_frame(std::uint64_t request, wire::Json json, const Status& fault) {
  json["command"] = "count";
  json["fault"] = wire::failure_json(fault)["failure"];
  wire::FrameHeader header;
  header.request = request;
  return wire::encode_frame(header, wire::dump_json(json));
}

}  // namespace

bool MemberScene::State::can_count(const MemberStepOptions& with) const {
  const bool edits = !with.removed.empty() || (with.inserted != nullptr && with.inserted->positions.count > 0);
  return when_needed && last_step && filled && !edits && !with.want_changes && (!weights || !with.weights.empty());
}

Result<std::optional<Frame>> MemberScene::State::count(const Positions& positions, std::span<const std::int64_t> ids,
                                                       std::int64_t step, const MemberStepOptions& with,
                                                       const Retry& retry) {
  static constexpr int kTriesMax = 8;  // others may change the cuts, again and again
  const std::optional<Frame> send;
  if (!can_count(with)) return send;
  if (!scene_cuts.known) {
    auto found = SceneCuts::ask(session(), name, retry);
    if (!found) return found.status();
    scene_cuts.known = std::move(*found);
  }
  std::optional<int> scale;
  for (int tries = 0; tries < kTriesMax; ++tries) {
    const Status counted =
        counting.count(*scene_cuts.known, {positions, ids, with.weights, weights, with.threads}, last_step, scale);
    wire::Json json{{"scene", name},
                    {"session", session().number()},
                    {"step", step},
                    {"incarnation", incarnation},
                    {"deadline_seconds", retry.seconds_left()}};
    if (with.step_seconds) json["step_seconds"] = *with.step_seconds;
    const std::uint64_t request = session().next_request();
    const std::string frame =
        counted ? counting.frame(request, std::move(json)) : fault_frame(request, std::move(json), counted);
    auto told = session().exchange_frames(request, frame, fmt::format("count of step {} of scene '{}'", step, name),
                                          retry.deadline());
    if (!counted) return counted;  // the others have been told
    if (!told) return told.status();
    const auto answer = told->json();
    if (!answer) return answer.status();
    if (answer->contains("report")) return std::optional(std::move(*told));
    const auto again = answer->find("again");
    if (again == answer->end()) return send;
    if (*again == "scale") {
      const auto due = wire::integer_field(*answer, "scale", -kScaleMost, kScaleMost);
      if (!due) return due.status();
      scale = static_cast<int>(*due);
      continue;
    }
    auto others = SceneCuts::ask(session(), name, retry);
    if (!others) return others.status();
    scene_cuts.known = std::move(*others);
  }
  return send;
}

}  // namespace rcb::client
