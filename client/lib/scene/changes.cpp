// Steps other than "all positions": only some particles moved, particles are removed or inserted.
#include "client/lib/scene/changes.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include <fmt/format.h>

#include "common/base/axis_names.hpp"
#include "common/wire/frame.hpp"

namespace rcb::client {
namespace {

std::string slice_frame(const wire::Json& begin, std::uint64_t request, const char* holds, std::size_t count,
                        std::span<const Column> columns) {
  wire::Json json{{"command", "push.slice"}, {"holds", holds}};
  for (const char* name : {"scene", "session", "step", "attempt"}) json[name] = begin.at(name);
  std::string frame = slice_head(std::move(json), request, columns, count);
  for (const Column& column : columns) {
    const auto* const first = static_cast<const char*>(column.first);
    if (column.stride == 1)
      frame.append(first, count * column.bytes);
    else
      for (std::size_t i = 0; i < count; ++i) frame.append(first + i * column.stride * column.bytes, column.bytes);
  }
  return frame;
}

// Applies the edit to an array that is indexed by row.
template <typename T>
void move_with(const RowEdit& edit, std::vector<T>& rows, std::span<const T> inserted) {
  rows.resize(std::max<std::size_t>(rows.size(), edit.moves.new_count));
  for (const layout::SlotMove& m : edit.moves.moves) rows[m.to] = m.arrival ? inserted[m.from] : rows[m.from];
  rows.resize(edit.moves.new_count);
}

// whose: " of the inserted", or nothing.
Status check_axes(const std::string& scene, const Positions& positions, int dims, const char* whose) {
  for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a)
    if (positions.count > 0 && (positions.single() ? positions.axis_f4[a] == nullptr : positions.axis[a] == nullptr))
      return wrong_push(scene, fmt::format("no array for axis {}{}", kAxisNames[a], whose), "give one array an axis");
  return {};
}

}  // namespace

EditFrames edit_frames(const wire::Json& begin, std::uint64_t request, std::span<const std::int64_t> removed,
                       const Insertion* inserted) {
  EditFrames frames;
  const auto add = [&](const char* holds, std::size_t count, std::span<const Column> columns) {
    frames.bytes += slice_frame(begin, request, holds, count, columns);
    ++frames.count;
  };
  if (inserted != nullptr && inserted->positions.count > 0) {
    std::vector<Column> columns = columns_of(inserted->positions, inserted->weights);
    if (!inserted->ids.empty()) columns.push_back({"id", "<i8", inserted->ids.data()});
    add("inserted", inserted->positions.count, columns);
  }
  if (!removed.empty()) add("removed", removed.size(), std::array{Column{"id", "<i8", removed.data()}});
  return frames;
}

Status wrong_push(const std::string& scene, const std::string& message, std::string hint) {
  return {Code::invalid_argument, fmt::format("push to scene '{}': {}", scene, message), std::move(hint)};
}

Status check_arrays(const std::string& scene, const Positions& positions, int dims) {
  if (positions.dims != dims)
    return wrong_push(scene, fmt::format("positions of {} dimensions, the scene has {}", positions.dims, dims),
                      "create the scene with the positions' dims");
  if (Status status = check_axes(scene, positions, dims, ""); !status) return status;
  return positions.stride > 0 ? Status() : wrong_push(scene, "a stride of 0", "a stride is at least 1");
}

Status check_terms(const std::string& scene, std::optional<std::int64_t> step, std::optional<double> step_seconds,
                   double deadline_seconds, int threads) {
  if (step && *step < 0) return wrong_push(scene, fmt::format("step {}", *step), "steps are numbered from 0");
  if (step_seconds && !(*step_seconds >= 0 && std::isfinite(*step_seconds)))
    return wrong_push(scene, fmt::format("a step of {} seconds", *step_seconds), "give a finite number >= 0, or none");
  if (threads < 1) return wrong_push(scene, fmt::format("{} threads", threads), "give 1 or more");
  if (!(deadline_seconds > 0))
    return wrong_push(scene, fmt::format("a deadline of {} seconds", deadline_seconds), "give a number above 0");
  return {};
}

Status check_insertion(const std::string& scene, const Insertion& in, const Positions& others, int dims, bool weights) {
  const Positions& positions = in.positions;
  if (positions.dims != dims) return wrong_push(scene, "the inserted must have the scene's dimensions", "");
  if (Status status = check_axes(scene, positions, dims, " of the inserted"); !status) return status;
  if (others.count > 0 && positions.count > 0 && positions.single() != others.single())
    return wrong_push(scene, "the inserted and the others differ in precision",
                      "give both as double or both as float32");
  if (!in.ids.empty() && in.ids.size() != positions.count)
    return wrong_push(scene, fmt::format("{} ids for {} inserted particles", in.ids.size(), positions.count),
                      "give one id a particle, or none");
  if (in.weights.size() != (weights ? positions.count : 0))
    return wrong_push(scene, fmt::format("{} weights for {} inserted particles", in.weights.size(), positions.count),
                      weights ? "give one weight a particle" : "the scene has no weights");
  return {};
}

Status Scene::State::check_edits(const StepRequest& ask) const {
  if (!ask.edits()) return {};
  if (!pushed_)
    return wrong("insertions or removals, and the scene has no particles yet", "push a first step with all of them");
  if (ask.options.removed.size() > count_)
    return wrong(fmt::format("{} particles to remove, the scene has {}", ask.options.removed.size(), count_), "");
  if (ask.options.inserted == nullptr) return {};
  return check_insertion(name_, *ask.options.inserted, ask.positions, dims_, has_weights_);
}

Result<Selection> Scene::State::select(const StepRequest& ask) const {
  struct Place {
    std::uint64_t slot;
    std::uint64_t place;
  };
  const auto by_slot = [](const Place& a, const Place& b) { return a.slot < b.slot; };
  std::vector<std::vector<Place>> places(static_cast<std::size_t>(plan_->ranks()));
  const auto add = [&](std::uint64_t row, std::uint64_t place) {
    places[static_cast<std::size_t>(plan_->rank_of_row(row))].push_back({plan_->slot_of_row(row), place});
  };
  if (ask.moved == StepRequest::Moved::rows) {
    for (const std::uint64_t row : *ask.options.moved) {
      if (row >= count_) return wrong(fmt::format("row {} moved, there are {}", row, count_), "rows count from 0");
      add(row, row);
    }
  } else {
    for (std::size_t k = 0; k < ask.ids.size(); ++k) {
      const auto row = plan_->row_of_id(ask.ids[k]);
      if (!row)
        return Status(
            Code::not_found,
            fmt::format("push to scene '{}': particle {} moved, and the scene has none of that id", name_, ask.ids[k]));
      add(*row, k);
    }
  }
  Selection selection;
  selection.slots.resize(places.size());
  selection.places.resize(places.size());
  for (std::size_t rank = 0; rank < places.size(); ++rank) {
    std::vector<Place>& of_rank = places[rank];
    // Usually ascending rows have ascending slots, so there is nothing to sort.
    if (!std::is_sorted(of_rank.begin(), of_rank.end(), by_slot)) std::sort(of_rank.begin(), of_rank.end(), by_slot);
    auto& slots = selection.slots[rank];
    slots.reserve(of_rank.size());
    selection.places[rank].reserve(of_rank.size());
    for (const Place& place : of_rank) {
      if (!slots.empty() && slots.back() == place.slot)
        return wrong(fmt::format("particle {} is named twice",
                                 plan_->id_of_row(plan_->rows(static_cast<int>(rank))[place.slot])),
                     "name what moved once");
      slots.push_back(place.slot);
      selection.places[rank].push_back(place.place);
    }
  }
  return selection;
}

Result<RowEdit> Scene::State::row_edit(const StepRequest& ask) const {
  RowEdit edit;
  for (const std::int64_t id : ask.options.removed) {
    const auto row = plan_->row_of_id(id);
    if (!row)
      return Status(Code::not_found, fmt::format("push to scene '{}': particle {} is to be removed, and the scene has "
                                                 "none of that id",
                                                 name_, id));
    edit.removed.push_back(*row);
  }
  std::sort(edit.removed.begin(), edit.removed.end());
  if (const auto twin = std::adjacent_find(edit.removed.begin(), edit.removed.end()); twin != edit.removed.end())
    return wrong(fmt::format("particle {} is removed twice", plan_->id_of_row(*twin)), "name it once");
  edit.moves = layout::edit_of_rank(count_, edit.removed, ask.inserted());
  return edit;
}

void Scene::State::edit_rows(const StepRequest& ask, RowEdit& edit, const StepReport& report, const Frame& answer,
                             bool follows, StepResult& result) {
  for (const layout::SlotMove& move : edit.moves.moves) result.row_moves.push_back({move.to, move.from, move.arrival});
  result.inserted_ids.resize(ask.inserted());
  if (report.first_id) std::iota(result.inserted_ids.begin(), result.inserted_ids.end(), *report.first_id);
  if (ask.inserted() > 0 && !ask.options.inserted->ids.empty())
    result.inserted_ids.assign(ask.options.inserted->ids.begin(), ask.options.inserted->ids.end());

  std::vector<std::int32_t>& parts = edit.inserted_part;
  parts.assign(ask.inserted(), -1);
  std::vector<std::int32_t> ranks;
  if (const auto given = answer.array<std::int32_t>("inserted_part"); given && given->size() == parts.size())
    parts.assign(given->begin(), given->end());
  for (const std::int32_t part : parts) {
    follows = follows && part >= 0 && part < parts_count_;
    if (follows) ranks.push_back(layout::rank_of_part(part, parts_count_, plan_->ranks()));
  }
  if (weights_.size() == count_ && has_weights_) {
    const std::span<const double> inserted =
        ask.inserted() > 0 ? ask.options.inserted->weights : std::span<const double>();
    move_with(edit, weights_, inserted);
  }
  move_rows(edit, result.inserted_ids);
  if (!follows || !plan_->edit(edit.removed, result.inserted_ids, ranks).ok()) plan_.reset();
}

void Scene::State::move_rows(const RowEdit& edit, std::span<const std::int64_t> ids) {
  const std::vector<std::int32_t> open(ids.size(), -1);
  bool still_rows = ids_.empty() && edit.removed.empty();
  for (std::size_t i = 0; i < ids.size(); ++i)
    still_rows = still_rows && ids[i] == static_cast<std::int64_t>(count_ + i);
  if (!still_rows) {
    if (ids_.empty()) {
      ids_.resize(count_);
      std::iota(ids_.begin(), ids_.end(), std::int64_t{0});
    }
    move_with(edit, ids_, ids);
    has_ids_ = true;
  }
  if (parts_.size() == count_) move_with(edit, parts_, std::span(open));
  if (known_ && known_->size() == count_) move_with(edit, *known_, std::span(open));
  count_ = edit.moves.new_count;
}

}  // namespace rcb::client
