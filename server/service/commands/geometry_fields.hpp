// Positions, boxes and distances as requests say them. Errors of all: invalid_argument, not_finite.
#pragma once

#include <string>

#include "common/cuts/periodic.hpp"
#include "common/wire/message.hpp"

namespace rcb::service {

// A field of exactly `dims` finite numbers. label: what messages call it.
Result<geometry::Point> point_field(const wire::Json& object, const char* name, const std::string& label, int dims);
// The fields "lo" and "hi": null where the box has no bound, as `cuts` writes it. prefix: of their names in messages.
Result<geometry::Box> box_fields(const wire::Json& object, const std::string& prefix, int dims);
// The field "periodic", such a box; an axis without bounds isn't periodic. Absent: none is.
Result<cuts::PeriodicBox> periodic_field(const wire::Json& request, int dims);
// The fields "width", "norm" and "periodic".
Result<cuts::Near> near_fields(const wire::Json& request, int dims);

}  // namespace rcb::service
