// Positions and boxes of the interface, checked, as those of C++.
#pragma once

#include <span>

#include "client/include/rcbd/rcbd.h"
#include "common/base/status.hpp"
#include "common/cuts/periodic.hpp"
#include "common/cuts/positions.hpp"

namespace rcb::c {

Result<cuts::Positions> positions_of(const rcbd_positions* given);
// lo, hi: [dims]; both null: not periodic.
Result<cuts::PeriodicBox> periodic_box(const double* lo, const double* hi, int dims);

// An array that may be left out.
template <typename T>
std::span<const T> optional_array(const T* first, std::size_t count) {
  return first == nullptr ? std::span<const T>() : std::span(first, count);
}

}  // namespace rcb::c
