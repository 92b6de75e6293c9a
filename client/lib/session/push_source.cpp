#include "client/lib/session/push_source.hpp"

#include <algorithm>
#include <cstring>

#include "common/base/axis_names.hpp"
#include "common/wire/frame.hpp"

namespace rcb::client {
namespace {

constexpr std::size_t kElementBytesMax = 8;
constexpr std::size_t kBatchBytes = 1U << 20U;
constexpr std::size_t kPiecesMax = 48;  // the number of pieces in one system call is limited

Bytes bytes_of(const std::string& text) { return std::as_bytes(std::span(text)); }

template <std::size_t kWidth>
void gather_wide(const Column& column, std::span<const std::uint64_t> rows, std::byte* to) {
  const std::byte* const first = static_cast<const std::byte*>(column.first);
  const std::size_t step = column.stride * kWidth;
  if (step == kWidth)
    for (std::size_t i = 0; i < rows.size(); ++i) std::memcpy(to + i * kWidth, first + rows[i] * kWidth, kWidth);
  else
    for (std::size_t i = 0; i < rows.size(); ++i) std::memcpy(to + i * kWidth, first + rows[i] * step, kWidth);
}

}  // namespace

bool consecutive(std::span<const std::uint64_t> rows) {
  for (std::size_t i = 1; i < rows.size(); ++i)
    if (rows[i] != rows[i - 1] + 1) return false;
  return true;
}

void gather(const Column& column, std::span<const std::uint64_t> rows, std::byte* to) {
  (column.bytes == sizeof(double) ? gather_wide<sizeof(double)> : gather_wide<sizeof(float)>)(column, rows, to);
}

std::vector<Column> columns_of(const Positions& positions, std::span<const double> weights) {
  std::vector<Column> columns;
  for (std::size_t a = 0; a < static_cast<std::size_t>(positions.dims); ++a)
    if (positions.single())
      columns.push_back({kAxisNames[a], "<f4", positions.axis_f4[a], positions.stride, nullptr, sizeof(float)});
    else
      columns.push_back({kAxisNames[a], "<f8", positions.axis[a], positions.stride});
  if (!weights.empty()) columns.push_back({"w", "<f8", weights.data(), 1});
  return columns;
}

wire::Json slice_json(const wire::Json& begin) {
  wire::Json slice{{"command", "push.slice"}};
  for (const char* name : {"scene", "session", "step", "attempt", "plan"}) slice[name] = begin.at(name);
  return slice;
}

RankRows all_rows(const layout::Layout& plan) {
  RankRows rows;
  for (int rank = 0; rank < plan.ranks(); ++rank) rows.push_back(plan.rows(rank));
  return rows;
}

std::size_t particle_bytes(std::span<const Column> columns) {
  std::size_t bytes = 0;
  for (const Column& column : columns) bytes += column.bytes;
  return bytes;
}

std::string slice_head(wire::Json slice, std::uint64_t request, std::span<const Column> columns, std::size_t count) {
  slice["count"] = count;
  slice["arrays"] = wire::Json::array();
  for (const Column& column : columns)
    slice["arrays"].push_back({{"name", column.name}, {"dtype", column.dtype}, {"shape", {count}}});
  wire::FrameHeader header;
  header.request = request;
  header.bulk_bytes = count * particle_bytes(columns);
  return wire::encode_frame(header, wire::dump_json(slice));
}

PushSource::PushSource(const wire::Json& begin, std::uint64_t request, RankRows rows, std::vector<Column> columns,
                       const std::string& edits, int edit_slices)
    : rows_(std::move(rows)), columns_(std::move(columns)), request_(request), slice_json_(slice_json(begin)) {
  wire::Json json = begin;
  json["command"] = "push.begin";
  int slices = edit_slices;
  for (const auto& of_rank : rows_) slices += of_rank.empty() ? 0 : 1;
  json["slices"] = slices;
  begin_frame_ = request_frame(request, json) + edits;
}

// Begins the frame of rank_'s slice.
void PushSource::begin_slice() {
  wire::Json json = slice_json_;
  json["rank"] = rank_;
  heads_.push_back(slice_head(std::move(json), request_, columns_, rows_[static_cast<std::size_t>(rank_)].size()));
  batch_.push_back(bytes_of(heads_.back()));
  batch_bytes_ += heads_.back().size();
  in_slice_ = true;
  column_ = 0;
  slot_ = 0;
}

// Adds as much of the current column as fits into the batch.
void PushSource::add_stretch() {
  const Column& column = columns_[column_];
  const auto all = rows_[static_cast<std::size_t>(rank_)];
  const std::size_t width = column.bytes;
  const std::size_t room = (kBatchBytes - std::min(batch_bytes_, kBatchBytes - width)) / width;
  const auto rows = all.subspan(slot_, std::min<std::size_t>(all.size() - slot_, room));
  const std::size_t bytes = rows.size() * width;
  const bool run = column.side_by_side() && consecutive(rows);  // looks at every row of a run
  if (const std::byte* const values = column.in_place(rank_, slot_, rows, run)) {
    batch_.emplace_back(values, bytes);
  } else {
    if (gathered_.empty()) gathered_.resize(kBatchBytes + kElementBytesMax);
    std::byte* to = gathered_.data() + gathered_bytes_;
    gather(column, rows, to);
    batch_.emplace_back(to, bytes);
    gathered_bytes_ += bytes;
  }
  batch_bytes_ += bytes;
  slot_ += rows.size();
  if (slot_ < all.size()) return;
  slot_ = 0;
  if (++column_ < columns_.size()) return;
  in_slice_ = false;
  ++rank_;
}

std::span<const Bytes> PushSource::next(bool answered) {
  batch_.clear();
  heads_.clear();
  heads_.reserve(kPiecesMax);  // batch_ points into its strings, which must not move
  batch_bytes_ = 0;
  gathered_bytes_ = 0;
  if (!begin_frame_.empty()) {
    heads_.push_back(std::move(begin_frame_));
    begin_frame_.clear();
    batch_.push_back(bytes_of(heads_.back()));
    batch_bytes_ = heads_.back().size();
  }
  while (batch_bytes_ < kBatchBytes && batch_.size() < kPiecesMax) {
    if (!in_slice_) {
      const int ranks = static_cast<int>(rows_.size());
      while (rank_ < ranks && rows_[static_cast<std::size_t>(rank_)].empty()) ++rank_;
      if (rank_ >= ranks || answered) break;
      begin_slice();
      continue;
    }
    add_stretch();
  }
  return batch_;
}

}  // namespace rcb::client
