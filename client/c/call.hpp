// What every function of the interface does around its work: it computes with the default floating-point environment,
// lets no exception out, and keeps what was wrong for rcbd_message().
//
// A solver may have its own environment: traps, which our checks for values out of range would set off; another
// rounding or denormals that count as 0, by which positions would be judged otherwise than by the service.
#pragma once

#include <cfenv>

#include "common/base/exceptions.hpp"
#include "common/base/status.hpp"

namespace rcb::c {

class DefaultFloatingPoint {
 public:
  DefaultFloatingPoint() {
    std::fegetenv(&before_);
    std::fesetenv(FE_DFL_ENV);
  }
  DefaultFloatingPoint(const DefaultFloatingPoint&) = delete;
  DefaultFloatingPoint& operator=(const DefaultFloatingPoint&) = delete;
  ~DefaultFloatingPoint() { std::fesetenv(&before_); }

 private:
  std::fenv_t before_;
};

// Keeps a failure for rcbd_message(), and returns its code.
int told(Status status) noexcept;

template <typename Work>
int call(const Work& work) noexcept {
  const DefaultFloatingPoint guard;
  return told(without_exceptions(work));
}

}  // namespace rcb::c
