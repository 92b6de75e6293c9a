// Halo: which particles a part needs besides its own. Particle i, owned by part p, is in the halo of part q if q's
// region is within the width of one of its images (Near, in periodic.hpp); for q = p only by images that are moved. The
// owner is the part whose region holds the position: hand particles over before asking for their halos.
#pragma once

#include <cstdint>
#include <span>

#include "common/base/buffer.hpp"
#include "common/cuts/periodic.hpp"
#include "common/cuts/positions.hpp"
#include "common/particles/particle_set.hpp"

namespace rcb::cuts {

struct OwnerOptions {
  std::span<const particles::Id> ids{};       // [count]: decide between particles on a cut; empty: the row is the id
  std::span<const std::int32_t> last_part{};  // [count]: a hint, the part of each row before; empty: none
  int threads = 1;                            // at most so many
};

struct HaloOptions : OwnerOptions {
  Near near{};
  std::span<const double> widths{};  // [count]: a width for each row, in the place of near.width; empty: none
  int seats = 0;                     // lists for so many processes (seat_of_part()); 0: for the parts
  std::uint64_t entries_max = std::uint64_t{1} << 28U;  // more are an error, too_large
};

// Compressed lists, a list for each part or seat, each by ascending row and, of one row, by ascending shift (the first
// axis decides first). A seat gets an image once, however many of its parts need it.
struct Halo {
  int dims = 3;
  Buffer<std::uint64_t> offset;  // [targets + 1]: where the lists begin, and the end
  Buffer<std::uint64_t> row;     // [entries]
  Buffer<std::int32_t> shift;    // [entries][dims], in periods; empty where no axis is periodic

  std::size_t targets() const { return offset.empty() ? 0 : offset.size() - 1; }
  std::size_t entries() const { return row.size(); }
  std::span<const std::uint64_t> rows_for(std::size_t target) const {
    return row.span().subspan(offset[target], offset[target + 1] - offset[target]);
  }
  // Of an entry; 0 along axes that aren't periodic.
  Shift shift_of(std::size_t entry) const {
    Shift found{};
    for (std::size_t a = 0; !shift.empty() && a < static_cast<std::size_t>(dims); ++a)
      found[a] = shift[entry * static_cast<std::size_t>(dims) + a];
    return found;
  }
};

// Of `seats` processes of a solver, number k has the parts from floor(k P / seats) up to, not including,
// floor((k + 1) P / seats). The seat that has this part:
constexpr int seat_of_part(int part, int parts, int seats) {
  // The largest k with floor(k P / seats) <= part, that is k P < (part + 1) seats.
  return static_cast<int>(((static_cast<std::int64_t>(part) + 1) * seats - 1) / parts);
}

}  // namespace rcb::cuts
