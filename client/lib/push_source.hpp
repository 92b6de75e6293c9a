// PushSource: the frames of one push, made while they are sent: push.begin, then a push.slice for each rank that holds
// particles, its columns in plan order.
//
// Invariants
// 1. A stretch of a column that lies in the caller's memory as it is to be sent is sent from there; only the others
//    are gathered, through one buffer of 1 MiB.
// 2. Frames are always whole; when the service has answered early, the frames not yet begun are left out.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "client/lib/session.hpp"
#include "common/base/buffer.hpp"
#include "common/plan/plan.hpp"
#include "common/wire/message.hpp"

namespace rcb::client {

// One array of every slice: elements `stride` elements apart, by the caller's row.
struct Column {
  std::string name;
  std::string dtype;
  const void* first = nullptr;
  std::size_t stride = 1;
  const void* const* by_rank = nullptr;  // instead of `first`: each rank's elements in the order they are sent
  std::size_t bytes = 8;                 // of an element

  const std::byte* of_rank(int rank, std::uint64_t slot) const {
    return static_cast<const std::byte*>(by_rank[rank]) + slot * bytes;
  }
};

// An axis of positions, double or float32. by_rank: of positions in the plan's order.
Column axis_column(const Positions& positions, std::size_t axis, const void* const* by_rank = nullptr);

// For each rank the rows that its slice holds, in the order they are sent.
using RankRows = std::vector<std::span<const std::uint64_t>>;
RankRows all_rows(const plan::Plan& plan);

// The bytes of a particle in all columns.
std::size_t particle_bytes(std::span<const Column> columns);

class PushSource final : public FrameSource {
 public:
  // begin: the arguments of push.begin without "slices". The rows and the columns outlive the source.
  // edits: whole frames of inserted and removed particles, as many as edit_slices.
  PushSource(const wire::Json& begin, std::uint64_t request, RankRows rows, std::vector<Column> columns,
             const std::string& edits = {}, int edit_slices = 0);
  std::span<const Bytes> next(bool answered) override;

 private:
  void begin_slice();
  void add_stretch();

  RankRows rows_;
  std::vector<Column> columns_;
  std::uint64_t request_;
  wire::Json slice_json_;           // what all slices have in common
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
