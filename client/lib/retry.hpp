// Retry: how long and how often one call goes on trying to reach a service that has gone.
//
// The first retry comes at once, since most losses are of a single connection; then one after about 50 ms, each later
// one after twice as long, at most after 2 s. Chance shortens each wait by up to half, so that the clients of a service
// that died don't all come to the next one in the same moment.
#pragma once

#include <cstdint>
#include <functional>
#include <string>

#include "client/lib/connection.hpp"
#include "common/base/backoff.hpp"

namespace rcb::client {

// How much longer than the service a client waits, so that the service's own answer arrives first.
double with_margin(double deadline_seconds);

class Retry {
 public:
  // deadline_seconds: of the whole call, as its caller gave it.
  explicit Retry(double deadline_seconds);

  // When the client stops waiting for an answer; no try begins in the margin before it.
  const Deadline& deadline() const { return deadline_; }
  // What is left for the service, whose own deadline it shall be; more than 0. At first all.
  double seconds_left() const;
  int failures() const { return failures_; }
  // "tried 3 times in 0.4 s"
  std::string tried() const;

  // After a try that failed: sleeps until the next one is due. False: the call's deadline has passed.
  // `tell`, which may be empty, hears now and then what is waited for.
  bool wait(const std::string& what, const NoticeHandler& tell);
  // True once after `tell` has heard of waiting: then it should also hear that it is over.
  bool end_of_waiting();

 private:
  double seconds_since_loss() const;

  double seconds_;
  Deadline until_;     // of tries
  Deadline deadline_;  // of answers
  Backoff backoff_;
  int failures_ = 0;
  Deadline::Clock::time_point first_failure_;
  double told_at_ = 0;  // seconds since the first failure; 0: not yet
};

}  // namespace rcb::client
