// Backoff: the pauses before one try after the other at something that fails. They double up to a cap, and chance
// shortens each, so that many who failed of the same cause don't all come back at the same moment.
#pragma once

#include <algorithm>
#include <cstdint>

#include "common/base/random.hpp"

namespace rcb {

struct BackoffOptions {
  double first_seconds;
  double most_seconds;
  double shortened;      // by this share of it at most, 0 .. 1
  bool at_once = false;  // before the first retry there is no pause
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
  // What failed has worked for long enough.
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
