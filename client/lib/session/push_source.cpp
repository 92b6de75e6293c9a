#include "client/lib/session/push_source.hpp"

#include <cstring>

#include "common/base/axis_names.hpp"
#include "common/wire/frame.hpp"

namespace rcb::client {
namespace {

constexpr std::size_t kBatchBytes = 1U << 20U;

template <std::size_t kWidth>
void gather_wide(const Column& column, const Rows& rows, std::byte* to) {
  const std::byte* const first = static_cast<const std::byte*>(column.first);
  const std::size_t step = column.stride * kWidth;
  if (rows.list == nullptr)
    for (std::size_t i = 0; i < rows.count; ++i) std::memcpy(to + i * kWidth, first + (rows.first + i) * step, kWidth);
  else
    for (std::size_t i = 0; i < rows.count; ++i) std::memcpy(to + i * kWidth, first + rows.list[i] * step, kWidth);
}

}  // namespace

void gather(const Column& column, const Rows& rows, std::byte* to) {
  if (const std::byte* const own = column.in_place(rows)) {
    std::memcpy(to, own, rows.count * column.bytes);
    return;
  }
  (column.bytes == sizeof(double) ? gather_wide<sizeof(double)> : gather_wide<sizeof(float)>)(column, rows, to);
}

bool interleaved(std::span<const Column> columns) {
  for (std::size_t k = 0; k < columns.size(); ++k)
    if (columns[k].stride != columns.size() || columns[k].bytes != columns[0].bytes ||
        static_cast<const std::byte*>(columns[k].first) !=
            static_cast<const std::byte*>(columns[0].first) + k * columns[k].bytes)
      return false;
  return columns.size() == 2 || columns.size() == 3;
}

std::vector<Column> columns_of(const Positions& positions, std::span<const double> weights,
                               std::span<const std::int64_t> ids) {
  std::vector<Column> columns;
  for (std::size_t a = 0; a < static_cast<std::size_t>(positions.dims); ++a)
    if (positions.single())
      columns.push_back({kAxisNames[a], "<f4", positions.axis_f4[a], positions.stride, sizeof(float)});
    else
      columns.push_back({kAxisNames[a], "<f8", positions.axis[a], positions.stride});
  if (!weights.empty()) columns.push_back({"w", "<f8", weights.data()});
  if (!ids.empty()) columns.push_back({"id", "<i8", ids.data()});
  return columns;
}

wire::Json slice_json(const wire::Json& push) {
  wire::Json slice{{"command", "push.slice"}};
  for (const char* name : {"scene", "step", "attempt"}) slice[name] = push.at(name);
  return slice;
}

std::size_t particle_bytes(std::span<const Column> columns) {
  std::size_t bytes = 0;
  for (const Column& column : columns) bytes += column.bytes;
  return bytes;
}

std::string frame_head(wire::Json json, std::uint64_t request, std::span<const Column> columns, std::size_t count) {
  json["arrays"] = wire::Json::array();
  for (const Column& column : columns)
    json["arrays"].push_back({{"name", column.name}, {"dtype", column.dtype}, {"shape", {count}}});
  wire::FrameHeader header;
  header.request = request;
  header.bulk_bytes = count * particle_bytes(columns);
  return wire::encode_frame(header, wire::dump_json(json));
}

PushSource::PushSource(const wire::Json& push, std::uint64_t request, std::size_t count, std::vector<Column> columns)
    : columns_(std::move(columns)), count_(count) {
  if (count == 0) columns_.clear();
  head_ = frame_head(push, request, columns_, count);
}

std::span<const Bytes> PushSource::next() {
  batch_.clear();
  if (!std::exchange(begun_, true)) batch_.push_back(std::as_bytes(std::span(head_)));
  const Rows all{.count = count_};
  for (std::size_t used = 0; column_ < columns_.size() && used < kBatchBytes;) {
    const Column& column = columns_[column_];
    Rows rows = all.part(row_, count_);
    if (const std::byte* const values = column.in_place(rows)) {
      batch_.emplace_back(values, rows.count * column.bytes);
    } else {
      rows = rows.part(0, std::max<std::size_t>(1, (kBatchBytes - used) / column.bytes));
      gathered_.resize(kBatchBytes + column.bytes);
      gather(column, rows, gathered_.data() + used);
      batch_.emplace_back(gathered_.data() + used, rows.count * column.bytes);
      used += rows.count * column.bytes;
    }
    row_ += rows.count;
    if (row_ < count_) continue;
    row_ = 0;
    ++column_;
  }
  return batch_;
}

}  // namespace rcb::client
