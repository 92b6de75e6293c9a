// kWaitSeconds: the longest that a test waits for what must come. It only ends a test that would hang, so it is far
// beyond what a loaded machine needs under a sanitizer.
#pragma once

namespace rcb::testing {

inline constexpr int kWaitSeconds = 100;

}  // namespace rcb::testing
