// kWaitSeconds: the longest that a test waits for what must come. It only ends a test that would hang, so it is far
// beyond what a loaded machine needs under a sanitizer.
#pragma once

#include <unistd.h>

namespace rcb::testing {

inline constexpr int kWaitSeconds = 100;

// Whether a condition comes to hold within that time.
template <typename Condition>
bool eventually(const Condition& condition) {
  for (int i = 0; i < 100 * kWaitSeconds; ++i) {
    if (condition()) return true;
    ::usleep(10'000);
  }
  return false;
}

}  // namespace rcb::testing
