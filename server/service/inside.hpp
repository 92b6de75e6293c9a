// Whether all of some coordinates lie strictly between two bounds; NaN and infinity never do.
#pragma once

#include <cstddef>

namespace rcb::service {

bool all_inside(const double* values, std::size_t count, double lo, double hi);

}  // namespace rcb::service
