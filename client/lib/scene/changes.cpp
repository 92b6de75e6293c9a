// Steps other than "all positions": only some particles moved, particles are removed or inserted.
#include "client/lib/scene/changes.hpp"

#include <algorithm>
#include <cstring>
#include <numeric>

#include <fmt/format.h>

#include "common/base/axis_names.hpp"
#include "common/wire/frame.hpp"

namespace rcb::client {
namespace {

// Appends an array to the bulk of a frame.
void append(std::string& bytes, const void* values, std::size_t size) {
  if (size > 0) bytes.append(static_cast<const char*>(values), size);
}

void append_axis(std::string& bytes, const Positions& positions, std::size_t axis) {
  for (std::size_t i = 0; i < positions.count; ++i)
    if (positions.single())
      append(bytes, positions.axis_f4[axis] + i * positions.stride, sizeof(float));
    else
      append(bytes, positions.axis[axis] + i * positions.stride, sizeof(double));
}

std::string slice_frame(const wire::Json& begin, std::uint64_t request, const char* holds, std::size_t count,
                        const std::vector<std::pair<std::string, std::string>>& arrays, const std::string& bulk) {
  wire::Json json{{"command", "push.slice"}, {"holds", holds}, {"count", count}, {"arrays", wire::Json::array()}};
  for (const char* name : {"scene", "session", "step", "attempt"}) json[name] = begin.at(name);
  for (const auto& [name, dtype] : arrays)
    json["arrays"].push_back({{"name", name}, {"dtype", dtype}, {"shape", {count}}});
  wire::FrameHeader header;
  header.request = request;
  header.bulk_bytes = bulk.size();
  return wire::encode_frame(header, wire::dump_json(json)) + bulk;
}

// Applies the edit to an array that is indexed by row.
template <typename T>
void move_with(const RowEdit& edit, std::vector<T>& rows, std::span<const T> inserted) {
  rows.resize(std::max<std::size_t>(rows.size(), edit.moves.new_count));
  for (const layout::SlotMove& m : edit.moves.moves) rows[m.to] = m.arrival ? inserted[m.from] : rows[m.from];
  rows.resize(edit.moves.new_count);
}

}  // namespace

EditFrames edit_frames(const wire::Json& begin, std::uint64_t request, std::span<const std::int64_t> removed,
                       const Insertion* inserted, int dims) {
  EditFrames frames;
  if (inserted != nullptr && inserted->positions.count > 0) {
    const Insertion& in = *inserted;
    std::string bulk;
    std::vector<std::pair<std::string, std::string>> arrays;
    for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a) {
      arrays.emplace_back(kAxisNames[a], in.positions.single() ? "<f4" : "<f8");
      append_axis(bulk, in.positions, a);
    }
    if (!in.weights.empty()) arrays.emplace_back("w", "<f8");
    append(bulk, in.weights.data(), in.weights.size_bytes());
    if (!in.ids.empty()) arrays.emplace_back("id", "<i8");
    append(bulk, in.ids.data(), in.ids.size_bytes());
    frames.bytes += slice_frame(begin, request, "inserted", in.positions.count, arrays, bulk);
    ++frames.count;
  }
  if (!removed.empty()) {
    std::string bulk;
    append(bulk, removed.data(), removed.size_bytes());
    frames.bytes += slice_frame(begin, request, "removed", removed.size(), {{"id", "<i8"}}, bulk);
    ++frames.count;
  }
  return frames;
}

Status check_insertion(const std::string& scene, const Insertion& in, const Positions& others, int dims, bool weights) {
  const auto wrong = [&scene](const std::string& message, std::string hint) {
    return Status(Code::invalid_argument, fmt::format("push to scene '{}': {}", scene, message), std::move(hint));
  };
  const Positions& positions = in.positions;
  if (positions.dims != dims || positions.in_plan_order())
    return wrong("the inserted must be rows or axes of the scene's dimensions", "");
  for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a)
    if (positions.count > 0 && (positions.single() ? positions.axis_f4[a] == nullptr : positions.axis[a] == nullptr))
      return wrong(fmt::format("no array for axis {} of the inserted", kAxisNames[a]), "give one array an axis");
  if (others.count > 0 && positions.count > 0 && positions.single() != others.single())
    return wrong("the inserted and the others differ in precision", "give both as double or both as float32");
  if (!in.ids.empty() && in.ids.size() != positions.count)
    return wrong(fmt::format("{} ids for {} inserted particles", in.ids.size(), positions.count),
                 "give one id a particle, or none");
  if (in.weights.size() != (weights ? positions.count : 0))
    return wrong(fmt::format("{} weights for {} inserted particles", in.weights.size(), positions.count),
                 weights ? "give one weight a particle" : "the scene has no weights");
  return {};
}

Status Scene::State::check_edits(const StepRequest& ask) const {
  if (!ask.edits()) return {};
  if (!has_particles())
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
  const wire::Array* given = wire::find_array(answer.arrays, "inserted_part");
  if (given != nullptr && given->dtype == "<i4" && given->bytes.size() == 4 * parts.size() && !parts.empty())
    std::memcpy(parts.data(), given->bytes.data(), given->bytes.size());
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
