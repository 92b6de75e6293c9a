#include "client/cli/files/frame_pusher.hpp"

#include <algorithm>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace rcb::cli {
namespace {

io::Points like(const io::Points& frame, std::size_t count) {
  io::Points points;
  points.dims = frame.dims;
  points.count = count;
  points.position.assign(frame.position.size(), std::vector<double>(count));
  points.weight.assign(frame.weight.empty() ? 0 : count, 0);
  return points;
}

void copy_row(const io::Points& from, std::size_t row, io::Points& to, std::size_t at) {
  for (std::size_t a = 0; a < from.position.size(); ++a) to.position[a][at] = from.position[a][row];
  if (!from.weight.empty()) to.weight[at] = from.weight[row];
}

// A frame beside the scene before it.
struct Change {
  io::Points rows;  // of the scene; those of the removed have no meaning
  std::vector<std::int64_t> removed;
  io::Points inserted;
};

// ids: of the scene by row.
Change change_to(const io::Points& frame, const std::vector<std::int64_t>& ids) {
  Change change{like(frame, ids.size()), {}, {}};
  const std::vector<std::size_t> order = rows_by_id(frame);
  const auto id_of = [&frame](std::size_t row) { return frame.id[row]; };
  std::vector<bool> stays(frame.count);
  for (std::size_t row = 0; row < ids.size(); ++row) {
    const auto found = std::ranges::lower_bound(order, ids[row], {}, id_of);
    if (found == order.end() || id_of(*found) != ids[row]) {
      change.removed.push_back(ids[row]);
      continue;
    }
    copy_row(frame, *found, change.rows, row);
    stays[*found] = true;
  }
  const auto staying = static_cast<std::size_t>(std::ranges::count(stays, true));
  change.inserted = like(frame, frame.count - staying);
  for (std::size_t row = 0; row < frame.count; ++row) {
    if (stays[row]) continue;
    copy_row(frame, row, change.inserted, change.inserted.id.size());
    change.inserted.id.push_back(frame.id[row]);
  }
  return change;
}

// The ids by row after a step that changed the rows.
void move_rows(const std::vector<client::RowMove>& moves, std::size_t count, const std::vector<std::int64_t>& inserted,
               std::vector<std::int64_t>& ids) {
  ids.resize(std::max(ids.size(), count));
  for (const client::RowMove& move : moves) ids[move.to] = move.inserted ? inserted[move.from] : ids[move.from];
  ids.resize(count);
}

}  // namespace

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
  if (!has_particles_) return push_first(frame, step);
  const bool ids = !frame.id.empty() || (own_ids_ && frame.count == 0);
  if (ids != own_ids_)
    return Status(Code::invalid_argument,
                  own_ids_ ? "no ids, which the scene's particles have" : "ids, which the scene's particles don't have",
                  "take the same columns in every frame");
  if (!ids && frame.count != count_)
    return Status(Code::invalid_argument, fmt::format("{} rows, and the step before had {}", frame.count, count_),
                  "where particles come and go, a column of ids has to say which: id x y z");
  if (ids && frame.id != ids_) return push_changed(frame, step);
  step.weights = frame.weight;
  step.ids = frame.id;
  const CompactPositions sent(frame);
  auto result = scene_.step(sent.positions(), step);
  said_ids_ = said_ids_ || result.ok();
  return result;
}

Result<client::StepResult> FramePusher::push_first(const io::Points& frame, client::StepOptions step) {
  step.weights = frame.weight;
  step.ids = frame.id;
  const CompactPositions sent(frame);
  auto result = scene_.step(sent.positions(), step);
  if (!result) return result;
  has_particles_ = said_ids_ = true;
  own_ids_ = !frame.id.empty();
  count_ = frame.count;
  ids_ = frame.id;
  return result;
}

Result<client::StepResult> FramePusher::push_changed(const io::Points& frame, client::StepOptions step) {
  const Change change = change_to(frame, ids_);
  const CompactPositions sent(change.rows), new_sent(change.inserted);
  const bool adds = change.inserted.count > 0;
  const bool single = (change.rows.count == 0 || sent.single()) && (!adds || new_sent.single());
  const client::Insertion insertion{new_sent.positions(single && adds), change.inserted.id, change.inserted.weight};
  if (adds) step.inserted = &insertion;
  step.removed = change.removed;
  step.weights = change.rows.weight;
  if (!said_ids_) step.ids = ids_;
  auto result = scene_.step(sent.positions(single && change.rows.count > 0), step);
  if (!result) return result;
  said_ids_ = true;
  count_ = frame.count;
  move_rows(result->row_moves, frame.count, change.inserted.id, ids_);
  return result;
}

}  // namespace rcb::cli
