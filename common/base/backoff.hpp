// Backoff: the pauses between retries. Each is twice as long as the one before, up to a maximum, and is shortened by a
// random share, so that many clients that failed for the same reason don't all retry at the same moment.
#pragma once

#include <algorithm>
#include <cstdint>

#include "common/base/random.hpp"

namespace rcb {

struct BackoffOptions {
  double first_seconds;
  double most_seconds;
  double shortened;      // largest random share, 0 .. 1, taken off a pause
  bool at_once = false;  // the first retry comes without a pause
};

class Backoff {
 public:
  Backoff(const BackoffOptions& options, std::uint64_t seed) : options_(options), random_(seed) {}

  // The pause after one more failure.
  double next() {
    ++failures_;
    if (options_.at_once && failures_ == 1) return 0;
    longest_ = longest_ == 0 ? options_.first_seconds : std::min(2 * longest_, options_.most_seconds);
    return random_.uniform((1 - options_.shortened) * longest_, longest_);
  }
  int failures() const { return failures_; }
  // Call once the retried operation has worked for long enough: the next failure starts with the first pause again.
  void reset() {
    failures_ = 0;
    longest_ = 0;
  }

 private:
  BackoffOptions options_;
  Random random_;
  int failures_ = 0;
  double longest_ = 0;
};

}  // namespace rcb
