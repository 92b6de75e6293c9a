// When a service that is silent counts as dead. Clocks are the caller's, so that it can be tested without waiting.
#pragma once

#include <algorithm>

namespace rcb::launch {

// The service is asked every now and then. It counts as silent when it has not answered for long enough, three times at
// least and counted from the first question that it left open: a machine or a supervisor that slept is no silence.
class Silence {
 public:
  static constexpr int kQuestionsMin = 3;

  Silence(double ask_seconds, double silence_seconds) : ask_seconds_(ask_seconds), silence_seconds_(silence_seconds) {}

  // The service starts; it may take so long until its first answer.
  void begin(double now, double start_seconds) {
    due_ = now + ask_seconds_;
    open_ = 0;
    since_ = now;
    allowed_seconds_ = std::max(start_seconds, silence_seconds_);
    answered_ = false;
  }
  // When it is to be asked next.
  double due() const { return due_; }
  // Whether it must be given up. asked_at: before the question.
  bool heard(bool answer, double asked_at, double now) {
    due_ = now + ask_seconds_;
    if (answer) {
      answered_ = true;
      allowed_seconds_ = silence_seconds_;
      open_ = 0;
      return false;
    }
    if (++open_ == 1 && answered_) since_ = asked_at;
    return open_ >= kQuestionsMin && now - since_ >= allowed_seconds_;
  }
  bool answered() const { return answered_; }
  double silent_seconds(double now) const { return open_ > 0 ? now - since_ : 0; }

 private:
  double ask_seconds_;
  double silence_seconds_;
  double allowed_seconds_ = 0;
  double due_ = 0;
  double since_ = 0;  // of the silence
  int open_ = 0;      // questions in a row
  bool answered_ = false;
};

}  // namespace rcb::launch
