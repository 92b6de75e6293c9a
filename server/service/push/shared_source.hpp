// SharedSource: reads the values of a push out of memory that the client shares with this rank.
//
// Invariants
// 1. Each value is read once. The client may write at any moment, so whatever is decided is decided on the copy.
// 2. Nothing outside the memory is read, whatever the push says.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "common/base/status.hpp"
#include "common/particles/particle_set.hpp"
#include "server/api/slice.hpp"
#include "server/service/context/order.hpp"

namespace rcb::service {

class SharedSource {
 public:
  // Checks that the slice's arrays lie within the memory. Errors: aborted (this rank has no such memory),
  // invalid_argument.
  static Result<SharedSource> open(const PushSlice& slice, int dims);

  // Copies the positions on `axis` of these rows.
  void positions(std::size_t axis, std::span<const particles::Id> rows, double* to) const;
  void weights(std::span<const particles::Id> rows, double* to) const;
  void ids(std::span<const particles::Id> rows, particles::Id* to) const;
  // Of the slice's share of the array "row", some elements from the k-th on. Errors: invalid_argument (there is no such
  // row).
  Status rows(std::uint64_t k, std::span<particles::Id> to) const;
  // Has the memory fetch the positions of rows that will be read soon. Without effect where they follow one another,
  // since the processor then fetches them by itself.
  void prefetch(std::span<const particles::Id> rows) const;

 private:
  struct Column {
    const std::byte* first = nullptr;
    std::uint64_t stride = 0;
  };

  int dims_ = 3;
  bool is_float32_ = false;
  std::uint64_t rows_ = 0;
  std::array<Column, 3> axis_;
  Column weight_, id_, row_;
  std::vector<api::SharedColumn> keeps_;  // the memory
};

}  // namespace rcb::service
