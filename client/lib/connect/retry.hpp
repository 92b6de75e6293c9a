// Retry: how long and how often one call tries again to reach a service that has gone.
//
// The first retry comes at once, since most losses are of a single connection; the next after about 50 ms, and each
// later one after twice as long, up to 2 s. Each wait is shortened at random by up to half, so that the clients of a
// service that died don't all reconnect at the same moment.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>

#include "client/lib/connect/connection.hpp"
#include "common/base/backoff.hpp"

namespace rcb::client {

// The client's deadline: later than the service's, so that the service's own answer arrives first.
double with_margin(double deadline_seconds);

class Retry {
 public:
  // deadline_seconds: of the whole call, as given by its caller.
  explicit Retry(double deadline_seconds);

  // When the client stops waiting for an answer, later than the call's deadline by the margin; no attempt begins in the
  // margin.
  const Deadline& deadline() const { return deadline_; }
  // Time left, to be sent as the service's deadline; always more than 0. At first all of it.
  double seconds_left() const;
  int failures() const { return failures_; }
  // "tried 3 times in 0.4 s"
  std::string tried() const;

  // After a failed attempt: sleeps until the next one is due. False: the call's deadline has passed. `tell`, which may
  // be empty, is called from time to time with what is waited for.
  bool wait(const std::string& what, const NoticeHandler& tell);
  // True once after `tell` has been called: the caller should then also tell that the wait is over.
  bool end_of_waiting();

 private:
  double seconds_since_loss() const;

  double seconds_;
  Deadline attempts_until_;         // no attempt begins later
  Deadline deadline_;               // for answers
  std::optional<Backoff> backoff_;  // from the first failure on: most calls have none, and a seed costs 10 us
  int failures_ = 0;
  Deadline::Clock::time_point first_failure_;
  double told_at_ = 0;  // seconds since the first failure; 0: not yet
};

}  // namespace rcb::client
