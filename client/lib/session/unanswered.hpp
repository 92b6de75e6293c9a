// UnansweredStep: a step that may have been committed although its answer didn't come. The call that pushed it tries it
// again under the same number. A later call does so only if it pushes the same content. Otherwise it must first find
// out whether the step was committed: the service would take the new content for the old step, and drop it.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <utility>

#include "client/lib/session/session.hpp"

namespace rcb::client {

class UnansweredStep {
 public:
  explicit operator bool() const { return number_.has_value(); }
  std::optional<std::int64_t> number() const { return number_; }
  // Nothing else can be pushed before its answer is known.
  bool needed() const { return needed_; }

  // Before a push. True if an earlier push of this number may have been committed.
  bool begin(std::int64_t number) { return std::exchange(number_, number) == number; }
  // After the failure of a push; tried_before: as begin() said. A number that is refused as stale is another session's.
  void failed(Code code, bool tried_before) {
    const bool unknown = code == Code::unavailable || code == Code::deadline_exceeded || code == Code::aborted ||
                         code == Code::interrupted;
    if (code == Code::stale_step || (!unknown && !tried_before)) answered();
  }
  void answered() {
    number_.reset();
    needed_ = false;
  }
  // At the end of a call that failed. content: a checksum (Content).
  void keep(std::uint64_t content, bool needed) {
    content_ = content;
    needed_ = needed_ || needed;
  }
  // Whether a call pushes the same once more. step: its number, if it says one.
  template <typename ContentOf>
  bool is_pushed_again(std::optional<std::int64_t> step, const ContentOf& content_of) const {
    return number_ && step.value_or(*number_) == *number_ && content_of() == content_;
  }
  // was_committed: asks the service, and returns whether the step was committed and is needed. Errors: stale_step, if
  // so.
  Status settle(Session& session, const std::string& scene, Retry& retry,
                const std::function<Result<bool>()>& was_committed) {
    const auto needed = session.retry_until_deadline(retry, was_committed);
    if (!needed) return needed.status();
    if (*needed)
      return {Code::stale_step,
              fmt::format("step {} of scene '{}' was committed after all, although its answer didn't come", *number_,
                          scene),
              "push the same once more: the answer says which particles there are now; or create the scene again"};
    answered();
    return {};
  }

 private:
  std::optional<std::int64_t> number_;
  std::uint64_t content_ = 0;
  bool needed_ = false;
};

}  // namespace rcb::client
