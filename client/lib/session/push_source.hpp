// PushSource: makes the frames of one push while they are sent: push.begin, then a push.slice for each rank that holds
// particles, its columns in layout order.
//
// Invariants
// 1. Data that lies contiguously in the caller's memory, in the order to be sent, is sent from there; everything else
//    is gathered, through one buffer of 1 MiB.
// 2. Only whole frames are sent; once the service has answered early, no further frame is begun.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "client/lib/session/session.hpp"
#include "common/base/buffer.hpp"
#include "common/layout/layout.hpp"
#include "common/wire/message.hpp"

namespace rcb::client {

// Whether the rows follow one another.
bool consecutive(std::span<const std::uint64_t> rows);

// One array of every slice. Element of row i: first + i * stride elements.
struct Column {
  std::string name;
  std::string dtype;
  const void* first = nullptr;
  std::size_t stride = 1;
  const void* const* by_rank = nullptr;  // instead of `first`: each rank's, in the order to be sent (slots)
  std::size_t bytes = 8;                 // of one element

  // Whether the values of rows that follow one another lie side by side.
  bool side_by_side() const { return by_rank == nullptr && stride == 1; }
  // Where the values of these rows, a rank's from this slot on, lie side by side in the caller's memory; null if they
  // don't. run: the rows follow one another.
  const std::byte* in_place(int rank, std::uint64_t slot, std::span<const std::uint64_t> rows, bool run) const {
    if (by_rank != nullptr) return static_cast<const std::byte*>(by_rank[rank]) + slot * bytes;
    return run && side_by_side() ? static_cast<const std::byte*>(first) + rows[0] * bytes : nullptr;
  }
};

// Copies the values of these rows of the caller's array `first`.
void gather(const Column& column, std::span<const std::uint64_t> rows, std::byte* to);

// The axes, double or float32, and the weights if there are any.
std::vector<Column> columns_of(const Positions& positions, std::span<const double> weights);

// The fields that every slice of a push has in common with its push.begin.
wire::Json slice_json(const wire::Json& begin);

// For each rank, the rows in its slice, in the order to be sent.
using RankRows = std::vector<std::span<const std::uint64_t>>;
RankRows all_rows(const layout::Layout& plan);

// Bytes of one particle in all columns.
std::size_t particle_bytes(std::span<const Column> columns);

// The head of a slice's frame, before its columns, which hold `count` elements each. slice: its other fields.
std::string slice_head(wire::Json slice, std::uint64_t request, std::span<const Column> columns, std::size_t count);

class PushSource final : public FrameSource {
 public:
  // begin: the arguments of push.begin without "slices". The memory of rows and columns must outlive the source. edits:
  // the frames of inserted and removed particles, edit_slices of them.
  PushSource(const wire::Json& begin, std::uint64_t request, RankRows rows, std::vector<Column> columns,
             const std::string& edits = {}, int edit_slices = 0);
  std::span<const Bytes> next(bool answered) override;

 private:
  void begin_slice();
  void add_stretch();

  RankRows rows_;
  std::vector<Column> columns_;
  std::uint64_t request_;
  wire::Json slice_json_;           // fields common to all slices
  std::vector<std::string> heads_;  // of the frames in this batch
  std::vector<Bytes> batch_;
  std::size_t batch_bytes_ = 0;
  Buffer<std::byte> gathered_;
  std::size_t gathered_bytes_ = 0;
  bool in_slice_ = false;
  int rank_ = 0;
  std::size_t column_ = 0;
  std::uint64_t slot_ = 0;
  std::string begin_frame_;
};

}  // namespace rcb::client
