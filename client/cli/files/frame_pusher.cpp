#include "client/cli/files/frame_pusher.hpp"

#include <algorithm>
#include <iterator>
#include <numeric>

#include <fmt/format.h>

#include "client/cli/print/output.hpp"

namespace rcb::cli {
namespace {

// With the rows of those that stay in the same order in every frame, so that a step can tell how many crossed a cut.
io::Points by_id(const io::Points& frame) {
  io::Points sorted = frame;
  const std::vector<std::size_t> order = rows_by_id(frame);
  for (std::size_t row = 0; row < order.size(); ++row) {
    sorted.id[row] = frame.id[order[row]];
    for (std::size_t a = 0; a < frame.position.size(); ++a) sorted.position[a][row] = frame.position[a][order[row]];
    if (!frame.weight.empty()) sorted.weight[row] = frame.weight[order[row]];
  }
  return sorted;
}

}  // namespace

Status no_points(const std::string& file, const std::string& scene) {
  return {Code::invalid_argument, fmt::format("{}: holds no points, and scene '{}' has none yet", file, scene),
          "push a file that holds some; was this one written to its end?"};
}

Status check_not_held(const Json& shown, const std::string& scene, const std::string& hint) {
  if (shown.at("holders").empty()) return {};
  return {Code::busy, fmt::format("scene '{}' is held open by {}", scene, holders_text(shown)), hint};
}

Result<client::StepResult> FramePusher::push(const io::Points& frame, client::StepOptions step) {
  if (frame.id.empty() && frame.count > 0 && !ids_.empty()) {
    if (static_cast<std::size_t>(ids_.back()) >= ids_.size())
      return Status(Code::invalid_argument, "no ids, which the scene's particles have",
                    "take the same columns in every frame");
    if (frame.count != ids_.size())
      return Status(Code::invalid_argument,
                    fmt::format("{} rows, and the step before had {}", frame.count, ids_.size()),
                    "where particles come and go, a column of ids has to say which: id x y z");
  }
  const io::Points sorted = frame.id.empty() ? io::Points{} : by_id(frame);
  const io::Points& rows = frame.id.empty() ? frame : sorted;
  std::vector<std::int64_t> ids = rows.id, stay;
  if (ids.empty()) {
    ids.resize(frame.count);
    std::iota(ids.begin(), ids.end(), 0);
  }
  std::ranges::set_intersection(ids, ids_, std::back_inserter(stay));
  if (scene_.last_step()) {
    step.inserted = ids.size() - stay.size();
    step.removed = ids_.size() - stay.size();
  }
  step.weights = rows.weight;
  step.ids = rows.id;
  const CompactPositions sent(rows);
  auto result = scene_.step(sent.positions(), step);
  if (result) ids_ = std::move(ids);
  return result;
}

}  // namespace rcb::cli
