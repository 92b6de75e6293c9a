#include "client/lib/connect/retry.hpp"

#include <algorithm>
#include <random>
#include <thread>

#include <fmt/format.h>

#include "common/wire/limits.hpp"

namespace rcb::client {
namespace {

constexpr double kMarginSeconds = 2;
constexpr double kMarginShare = 0.05;
constexpr BackoffOptions kPauses{.first_seconds = 0.05, .most_seconds = 2, .shortened = 0.5, .at_once = true};
constexpr double kQuietSeconds = 0.5;  // shorter waits aren't reported
constexpr double kBetweenNoticesSeconds = 2;
constexpr double kLeastSeconds = 0.001;

double bounded(double seconds) { return std::clamp(seconds, kLeastSeconds, wire::kDeadlineSecondsMax); }

}  // namespace

double with_margin(double deadline_seconds) {
  return deadline_seconds + std::max(kMarginSeconds, kMarginShare * deadline_seconds);
}

Retry::Retry(double deadline_seconds)
    : seconds_(bounded(deadline_seconds)),
      attempts_until_(bounded(deadline_seconds)),
      deadline_(with_margin(bounded(deadline_seconds))) {}

double Retry::seconds_left() const { return failures_ == 0 ? seconds_ : bounded(attempts_until_.left_seconds()); }

double Retry::seconds_since_loss() const {
  return std::chrono::duration<double>(Deadline::Clock::now() - first_failure_).count();
}

std::string Retry::tried() const {
  return failures_ == 1 ? "tried once" : fmt::format("tried {} times in {:.1f} s", failures_, seconds_since_loss());
}

bool Retry::wait(const std::string& what, const NoticeHandler& tell) {
  if (failures_++ == 0) first_failure_ = Deadline::Clock::now();
  const double left = attempts_until_.left_seconds();
  if (left <= 0) return false;
  const double since = seconds_since_loss();
  if (tell && since >= kQuietSeconds && (told_at_ == 0 || since - told_at_ >= kBetweenNoticesSeconds)) {
    tell(fmt::format("waiting for {}; {}", what, tried()));
    told_at_ = since;
  }
  if (!backoff_) backoff_.emplace(kPauses, std::random_device{}());
  std::this_thread::sleep_for(std::chrono::duration<double>(std::min(backoff_->next(), left)));
  return true;
}

bool Retry::end_of_waiting() { return std::exchange(told_at_, 0) > 0; }

}  // namespace rcb::client
