// For an integer that is sure to fit into a narrower type: one that does not is a bug and ends the process; it never
// wraps.
#pragma once

#include <utility>

#include "common/base/check.hpp"

namespace rcb {

template <typename To, typename From>
constexpr To narrow(From value) {
  RCB_CHECK(std::in_range<To>(value), "integer out of range");
  return static_cast<To>(value);
}

}  // namespace rcb
