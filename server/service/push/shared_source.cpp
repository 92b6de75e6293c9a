#include "server/service/push/shared_source.hpp"

#include <algorithm>
#include <bit>

#include <fmt/format.h>

#include "common/base/wide.hpp"

namespace rcb::service {
namespace {

// Atomically, so that the compiler reads once.
template <typename Word>
Word read_once(const std::byte* at) {
  return __atomic_load_n(reinterpret_cast<const Word*>(at), __ATOMIC_RELAXED);
}

double read_f8(const std::byte* at) { return std::bit_cast<double>(read_once<std::uint64_t>(at)); }
double read_f4(const std::byte* at) { return static_cast<double>(std::bit_cast<float>(read_once<std::uint32_t>(at))); }
particles::Id read_i8(const std::byte* at) { return static_cast<particles::Id>(read_once<std::uint64_t>(at)); }

template <auto kRead, typename T>
void read_rows(const std::byte* first, std::uint64_t stride, std::span<const particles::Id> rows, T* to) {
  for (std::size_t i = 0; i < rows.size(); ++i) to[i] = kRead(first + static_cast<std::uint64_t>(rows[i]) * stride);
}

}  // namespace

Result<SharedSource> SharedSource::open(const PushSlice& slice, int dims) {
  SharedSource source;
  source.dims_ = dims;
  source.is_float32_ = slice.is_float32;
  source.rows_ = slice.rows;
  source.keeps_ = slice.shared;
  for (std::size_t a = 0; a < slice.shared.size(); ++a) {
    const auto& [where, memory] = slice.shared[a];
    if (!memory)
      return Status(Code::aborted, fmt::format("the client shares no memory {} with this rank", where.memory),
                    "share it over a connection to each rank, and push again");
    const bool axis = a < static_cast<std::size_t>(dims);
    const bool list = where.name == "row";
    const std::uint64_t first = list ? slice.first_row : 0;
    const std::uint64_t count = list ? slice.count : slice.rows;
    const std::uint64_t width = axis && slice.is_float32 ? 4 : 8;
    if (count > 0 && u128{where.offset} + u128{first + count - 1} * where.stride + width > memory->size())
      return Status(Code::invalid_argument,
                    fmt::format("array '{}' of {} rows doesn't lie within the {} bytes of memory {}", where.name, count,
                                memory->size(), where.memory));
    const Column column{memory->bytes().data() + where.offset + (count > 0 ? first * where.stride : 0), where.stride};
    (axis ? source.axis_[a] : list ? source.row_ : where.name == "w" ? source.weight_ : source.id_) = column;
  }
  return source;
}

Status SharedSource::rows(std::uint64_t k, std::span<particles::Id> to) const {
  for (particles::Id& row : to) row = read_i8(row_.first + k++ * row_.stride);
  const auto found = std::ranges::find_if(to, [this](auto row) { return static_cast<std::uint64_t>(row) >= rows_; });
  if (found == to.end()) return {};
  return {Code::invalid_argument,
          fmt::format("row {} is named, there are {}", static_cast<std::uint64_t>(*found), rows_)};
}

void SharedSource::positions(std::size_t axis, std::span<const particles::Id> rows, double* to) const {
  const auto [first, stride] = axis_[axis];
  is_float32_ ? read_rows<read_f4>(first, stride, rows, to) : read_rows<read_f8>(first, stride, rows, to);
}

void SharedSource::weights(std::span<const particles::Id> rows, double* to) const {
  read_rows<read_f8>(weight_.first, weight_.stride, rows, to);
}

void SharedSource::ids(std::span<const particles::Id> rows, particles::Id* to) const {
  read_rows<read_i8>(id_.first, id_.stride, rows, to);
}

void SharedSource::prefetch(std::span<const particles::Id> rows) const {
  if (rows.empty() || rows.back() - rows.front() == static_cast<particles::Id>(rows.size() - 1)) return;
  const auto dims = static_cast<std::size_t>(dims_);
  // In an array of rows the axes of a particle lie together.
  const bool together = dims > 1 &&
                        axis_[dims - 1].first - axis_[0].first < static_cast<std::ptrdiff_t>(axis_[0].stride) &&
                        axis_[dims - 1].first > axis_[0].first;
  for (std::size_t a = 0; a < dims; a += together ? dims - 1 : 1)
    for (const particles::Id row : rows)
      __builtin_prefetch(axis_[a].first + static_cast<std::uint64_t>(row) * axis_[a].stride);
}

}  // namespace rcb::service
