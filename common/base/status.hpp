// Status and Result: how a fault that comes from outside (input, peers, deadlines) is reported. Bugs of our own code
// are CHECKs (check.hpp). The code numbers are part of the protocol and never renumbered.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <utility>
#include <variant>

#include "common/base/check.hpp"

namespace rcb {

enum class Code : std::uint16_t {
  ok = 0,
  invalid_argument = 1,    // a value, name or file content that can't be accepted
  not_found = 2,           // no such scene, file, part, particle
  already_exists = 3,      // a scene of this name, created without --replace
  busy = 4,                // another push is open, the queue is full, the scene is in use
  stale_step = 6,          // the step number goes back, or another session has used it
  not_finite = 8,          // NaN or infinity in positions or weights
  protocol_error = 9,      // a frame that breaks the protocol; the connection is closed
  too_large = 10,          // over a stated limit
  not_authorised = 11,     // no or wrong token, another user
  unavailable = 12,        // nobody answers at the endpoint, or the connection was lost
  deadline_exceeded = 13,  // a wait ended without an answer
  aborted = 14,            // the push was given up; the previous step stands
  io_error = 15,           // a file can't be opened, read or written
  unsupported = 16,        // an unknown command, or what this service, endpoint or scene can't do
  internal = 17,           // a bug of ours that the service has survived
  usage = 18,              // wrong command line
  interrupted = 19,        // the caller gave up waiting, for instance by Ctrl-C
  not_conserved = 20,      // a step would lose or double particles
  duplicate_id = 21,       // two particles have the same id
};

// The name of a code in the protocol and in --json, such as "invalid_argument".
std::string_view code_name(Code code);
// The code of that name; Code::internal for an unknown name (a newer peer may know more codes).
Code code_from_name(std::string_view name);
// rcbctl's exit code: 1 refused or failed, 2 usage, 3 unreachable, 4 not authorised, 5 deadline, 130
// interrupted.
int exit_code(Code code);

class [[nodiscard]] Status {
 public:
  Status() = default;
  // message: what was wrong and where; hint: what to do, may be empty.
  Status(Code code, std::string message, std::string hint = {})
      : code_(code), message_(std::move(message)), hint_(std::move(hint)) {}

  bool ok() const { return code_ == Code::ok; }
  explicit operator bool() const { return ok(); }
  Code code() const { return code_; }
  const std::string& message() const { return message_; }
  const std::string& hint() const { return hint_; }

 private:
  Code code_ = Code::ok;
  std::string message_;
  std::string hint_;
};

// A value, or the Status that says why there is none.
template <typename T>
class [[nodiscard]] Result {
 public:
  Result(T value) : value_(std::in_place_index<0>, std::move(value)) {}        // NOLINT(google-explicit-constructor)
  Result(Status status) : value_(std::in_place_index<1>, std::move(status)) {  // NOLINT(google-explicit-constructor)
    RCB_CHECK(!std::get<1>(value_).ok(), "a Result needs a value or a failure");
  }

  bool ok() const { return value_.index() == 0; }
  explicit operator bool() const { return ok(); }
  Status status() const { return ok() ? Status{} : std::get<1>(value_); }
  T& value() & {
    RCB_CHECK(ok(), std::get<1>(value_).message());
    return std::get<0>(value_);
  }
  const T& value() const& {
    RCB_CHECK(ok(), std::get<1>(value_).message());
    return std::get<0>(value_);
  }
  T&& value() && {
    RCB_CHECK(ok(), std::get<1>(value_).message());
    return std::get<0>(std::move(value_));
  }
  T* operator->() { return &value(); }
  const T* operator->() const { return &value(); }
  T& operator*() & { return value(); }
  const T& operator*() const& { return value(); }

 private:
  std::variant<T, Status> value_;
};

}  // namespace rcb
