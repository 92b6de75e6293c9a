// Decides when a silent service counts as dead. Times are passed in, so that tests need not wait.
#pragma once

#include <algorithm>

namespace rcb::launch {

// The supervisor probes the service at intervals. The service is silent once at least three probes in a row are
// unanswered and enough time has passed since the first of them: so suspending the machine or the supervisor doesn't
// count as silence.
class SilenceWatch {
 public:
  static constexpr int kUnansweredMin = 3;

  SilenceWatch(double ask_seconds, double silence_seconds)
      : ask_seconds_(ask_seconds), silence_seconds_(silence_seconds) {}

  // To be called when the service starts: it may take `start_seconds` until its first answer.
  void begin(double now, double start_seconds) {
    due_ = now + ask_seconds_;
    open_ = 0;
    since_ = now;
    allowed_seconds_ = std::max(start_seconds, silence_seconds_);
    answered_ = false;
  }
  // When to probe next.
  double due() const { return due_; }
  // Takes the result of a probe; true if the service counts as dead. asked_at: time before the probe.
  bool record_probe(bool answer, double asked_at, double now) {
    due_ = now + ask_seconds_;
    if (answer) {
      answered_ = true;
      allowed_seconds_ = silence_seconds_;
      open_ = 0;
      return false;
    }
    if (++open_ == 1 && answered_) since_ = asked_at;
    return open_ >= kUnansweredMin && now - since_ >= allowed_seconds_;
  }
  // The service couldn't be asked, which tells nothing.
  void skip_probe(double now) { due_ = now + ask_seconds_; }
  bool answered() const { return answered_; }
  double silent_seconds(double now) const { return open_ > 0 ? now - since_ : 0; }

 private:
  double ask_seconds_;
  double silence_seconds_;
  double allowed_seconds_ = 0;
  double due_ = 0;
  double since_ = 0;  // begin of the silence
  int open_ = 0;      // unanswered probes in a row
  bool answered_ = false;
};

}  // namespace rcb::launch
