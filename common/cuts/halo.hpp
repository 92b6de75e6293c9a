// Halo: which particles a part needs besides its own. Particle i, owned by part p, is in the halo of part q if q's
// region is within the width of one of its images (periodic.hpp); for q = p only by images that are moved.
#pragma once

#include <cstdint>
#include <span>

#include "common/base/buffer.hpp"
#include "common/cuts/periodic.hpp"

namespace rcb::cuts {

// Compressed lists, a list for each part or seat, each by ascending row and, of one row, by ascending shift (the first
// axis decides first).
struct Halo {
  int dims = 3;
  Buffer<std::uint64_t> offset;  // [targets + 1]: where the lists begin, and the end
  Buffer<std::uint64_t> row;     // [entries]
  Buffer<std::int32_t> shift;    // [entries][dims], in periods; empty where no axis is periodic

  std::size_t targets() const { return offset.size() - 1; }
  std::size_t entries() const { return row.size(); }
  std::span<const std::uint64_t> rows_for(std::size_t target) const {
    return row.span().subspan(offset[target], offset[target + 1] - offset[target]);
  }
};

// Of `seats` processes of a solver, number k has the parts from floor(k P / seats) up to, not including,
// floor((k + 1) P / seats). The seat that has this part:
constexpr int seat_of_part(int part, int parts, int seats) {
  return static_cast<int>(((static_cast<std::int64_t>(part) + 1) * seats - 1) / parts);
}

}  // namespace rcb::cuts
