// Clock: an interface to the time, so that tests can set it.
#pragma once

#include <chrono>

namespace rcb {

class Clock {
 public:
  virtual ~Clock() = default;
  // Monotonic seconds from an arbitrary start.
  virtual double seconds() const = 0;
};

class SteadyClock final : public Clock {
 public:
  double seconds() const override {
    return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
  }
};

}  // namespace rcb
