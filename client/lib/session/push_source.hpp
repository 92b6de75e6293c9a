// The arrays of a push on their way to sockets: which rows, from where.
//
// PushSource: makes the frame of a push through the endpoint while it is sent, all rows in their order. What lies
// contiguously in the caller's memory is sent from there; everything else is gathered, through one buffer of 1 MiB.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "client/lib/session/session.hpp"
#include "common/base/buffer.hpp"
#include "common/wire/message.hpp"

namespace rcb::client {

// Rows of the caller's arrays, ascending: those of a list or, without one, some that follow one another.
struct Rows {
  const std::uint64_t* list = nullptr;
  std::uint64_t first = 0;  // without a list
  std::size_t count = 0;

  static Rows of(std::span<const std::uint64_t> list) {
    const bool run = !list.empty() && list.back() - list.front() + 1 == list.size();
    return {run ? nullptr : list.data(), run ? list.front() : 0, list.size()};
  }
  std::uint64_t operator[](std::size_t k) const { return list == nullptr ? first + k : list[k]; }
  // `most` of them, from number `from` on, or all that are left.
  Rows part(std::size_t from, std::size_t most) const {
    const std::size_t left = std::min(count - from, most);
    return list == nullptr ? Rows{nullptr, first + from, left} : of(std::span(list + from, left));
  }
};

// One array of every slice. Element of row i: first + i * stride elements.
struct Column {
  std::string name;
  std::string dtype;
  const void* first = nullptr;
  std::size_t stride = 1;
  std::size_t bytes = 8;  // of one element

  bool is_axis() const { return name[0] >= 'x'; }  // not w, id
  // Where the values of these rows lie side by side in the caller's memory; null if they don't.
  const std::byte* in_place(const Rows& rows) const {
    if (rows.list != nullptr || stride != 1) return nullptr;
    return static_cast<const std::byte*>(first) + rows.first * bytes;
  }
};

// Copies the values of these rows.
void gather(const Column& column, const Rows& rows, std::byte* to);

// Whether the columns are one (n, dims) array: column k is element k of each row.
bool interleaved(std::span<const Column> columns);

// The axes, double or float32, and what else isn't empty.
std::vector<Column> columns_of(const Positions& positions, std::span<const double> weights,
                               std::span<const std::int64_t> ids);

// The fields that every push.slice has in common with its push.
wire::Json slice_json(const wire::Json& push);

// Bytes of one particle in all columns.
std::size_t particle_bytes(std::span<const Column> columns);

// The head of a frame, before its columns, which hold `count` elements each. json: its other fields.
std::string frame_head(wire::Json json, std::uint64_t request, std::span<const Column> columns, std::size_t count);

class PushSource {
 public:
  // The memory of the columns must outlive the source.
  PushSource(const wire::Json& push, std::uint64_t request, std::size_t count, std::vector<Column> columns);
  // The next bytes, valid until the next call; empty: the end.
  std::span<const Bytes> next();

 private:
  std::string head_;  // before the columns
  std::vector<Column> columns_;
  std::size_t count_;
  bool begun_ = false;      // head_ has been sent
  std::size_t column_ = 0;  // the first that isn't sent completely
  std::size_t row_ = 0;     // of it
  Buffer<std::byte> gathered_;
  std::vector<Bytes> batch_;
};

}  // namespace rcb::client
