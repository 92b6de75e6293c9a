#include "client/c/positions.hpp"

#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "client/c/call.hpp"
#include "client/c/structs.hpp"

namespace rcb::c {
namespace {

Status bad_positions(std::string what) { return {Code::invalid_argument, "positions: " + std::move(what)}; }

// The image of a finite x in [lo, hi). One that is rounded to hi is at lo.
double wrapped(double x, double lo, double hi) {
  if (x >= lo && x < hi) return x;
  if (x == hi) return lo;  // hi - length may be rounded to something else
  const double length = hi - lo;
  double image = x < lo && x >= lo - length ? x + length : x - std::floor((x - lo) / length) * length;
  if (image < lo) image += length;  // the quotient was rounded
  return image >= lo && image < hi ? image : lo;
}

// To the nearest float in [lo, hi).
float narrowed(double x, double lo, double hi) {
  const auto image = static_cast<float>(x);
  if (image >= lo && image < hi) return image;
  const auto first = static_cast<float>(lo);
  return first >= lo ? first : std::nextafter(first, std::numeric_limits<float>::infinity());
}

template <typename T>
void wrap_axis(T* first, const cuts::Positions& positions, double lo, double hi) {
  for (std::size_t i = 0; i < positions.count; ++i) {
    T& x = first[i * positions.stride];
    const auto wide = static_cast<double>(x);
    if (wide >= lo && wide < hi) continue;
    if constexpr (sizeof(T) == sizeof(float))
      x = narrowed(wrapped(wide, lo, hi), lo, hi);
    else
      x = wrapped(wide, lo, hi);
  }
}

Status all_finite(const cuts::Positions& positions) {
  for (std::size_t i = 0; i < positions.count; ++i)
    for (const double x : positions.point(i))
      if (!std::isfinite(x)) return {Code::not_finite, fmt::format("position {} is not finite", i)};
  return {};
}

}  // namespace

Result<cuts::Positions> positions_of(const rcbd_positions* given) {
  if (given == nullptr) return bad_positions("a null pointer");
  const auto read = read_struct(given, rcbd_positions RCBD_POSITIONS, "RCBD_POSITIONS");
  if (!read) return read.status();
  if (read->count < 0) return bad_positions(fmt::format("{} of them", read->count));
  if (read->dims < 1 || read->dims > 3) return bad_positions(fmt::format("{} dimensions, not 1 to 3", read->dims));
  if (read->stride < 1) return bad_positions(fmt::format("a stride of {}, not 1 or more", read->stride));
  if (read->single != 0 && read->single != 1)
    return bad_positions(fmt::format("single is {}, not 0 or 1", read->single));
  cuts::Positions positions;
  positions.count = static_cast<std::size_t>(read->count);
  positions.stride = static_cast<std::size_t>(read->stride);
  positions.dims = read->dims;
  for (std::size_t a = 0; a < static_cast<std::size_t>(read->dims); ++a) {
    if (read->axis[a] == nullptr && read->count > 0) return bad_positions(fmt::format("axis {} is NULL", a));
    if (read->single != 0)
      positions.axis_f4[a] = static_cast<const float*>(read->axis[a]);
    else
      positions.axis[a] = static_cast<const double*>(read->axis[a]);
  }
  return positions;
}

Result<cuts::PeriodicBox> periodic_box(const double* lo, const double* hi, int dims) {
  cuts::PeriodicBox box;
  if ((lo == nullptr) != (hi == nullptr))
    return Status(Code::invalid_argument, "a box that has lo or hi alone", "give both, or neither");
  for (std::size_t a = 0; lo != nullptr && a < static_cast<std::size_t>(dims); ++a) {
    box.lo[a] = lo[a];
    box.hi[a] = hi[a];
  }
  return box;
}

}  // namespace rcb::c

int rcbd_wrap(const rcbd_positions* given, const double* lo, const double* hi) {
  using namespace rcb;  // NOLINT
  return c::call([&]() -> Status {
    const auto positions = c::positions_of(given);
    if (!positions) return positions.status();
    if (lo == nullptr || hi == nullptr) return {Code::invalid_argument, "no box: a null pointer"};
    const auto box = c::periodic_box(lo, hi, positions->dims);
    if (!box) return box.status();
    if (Status fits = cuts::Near{.box = *box}.check(positions->dims); !fits) return fits;
    if (Status finite = c::all_finite(*positions); !finite) return finite;
    for (std::size_t a = 0; a < static_cast<std::size_t>(positions->dims) && positions->count > 0; ++a) {
      if (!box->periodic(a)) continue;
      if (positions->single())
        c::wrap_axis(static_cast<float*>(given->axis[a]), *positions, box->lo[a], box->hi[a]);
      else
        c::wrap_axis(static_cast<double*>(given->axis[a]), *positions, box->lo[a], box->hi[a]);
    }
    return {};
  });
}
