#include "client/cli/files/frame_pusher.hpp"

#include <algorithm>
#include <iterator>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace rcb::cli {
Status no_points(const std::string& file, const std::string& scene) {
  return {Code::invalid_argument, fmt::format("{}: holds no points, and scene '{}' has none yet", file, scene),
          "push a file that holds some; was this one written to its end?"};
}

Status check_not_held(const Json& shown, const std::string& scene, const std::string& hint) {
  const auto holders = shown.at("members").get<std::vector<std::string>>();
  if (holders.empty()) return {};
  return {Code::busy, fmt::format("scene '{}' is held open by {}", scene, fmt::join(holders, ", ")), hint};
}

FramePusher::FramePusher(client::Scene scene, std::uint64_t count, std::vector<std::int64_t> ids)
    : scene_(std::move(scene)), has_particles_(true), own_ids_(!ids.empty()), count_(count), ids_(std::move(ids)) {}

Result<client::StepResult> FramePusher::push(const io::Points& frame, client::StepOptions step) {
  const bool ids = !frame.id.empty() || (own_ids_ && frame.count == 0);
  if (has_particles_ && ids != own_ids_)
    return Status(Code::invalid_argument,
                  own_ids_ ? "no ids, which the scene's particles have" : "ids, which the scene's particles don't have",
                  "take the same columns in every frame");
  if (has_particles_ && !ids && frame.count != count_)
    return Status(Code::invalid_argument, fmt::format("{} rows, and the step before had {}", frame.count, count_),
                  "where particles come and go, a column of ids has to say which: id x y z");
  std::vector<std::int64_t> sorted = frame.id, stay;
  std::ranges::sort(sorted);
  if (has_particles_) {
    std::ranges::set_intersection(sorted, ids_, std::back_inserter(stay));
    step.inserted = sorted.size() - stay.size();
    step.removed = ids_.size() - stay.size();
  }
  step.weights = frame.weight;
  step.ids = frame.id;
  const CompactPositions sent(frame);
  auto result = scene_.step(sent.positions(), step);
  if (!result) return result;
  has_particles_ = true;
  own_ids_ = ids;
  count_ = frame.count;
  ids_ = std::move(sorted);
  return result;
}

}  // namespace rcb::cli
