// Session, part 3: commands, which are repeated where that does no harm, and waited for where somebody else is in the
// way.
#include <algorithm>
#include <array>
#include <string_view>
#include <utility>

#include <fmt/format.h>

#include "client/lib/session/session.hpp"
#include "common/wire/message.hpp"

namespace rcb::client {
namespace {

// Commands that change nothing, or whose repetition changes nothing more.
bool repeatable(std::string_view command) {
  constexpr std::array<std::string_view, 19> kRepeatable{
      "status",  "scene.open", "scene.close", "scene.list", "scene.show", "error",  "counts",
      "cuts",    "history",    "stats",       "owner",      "box",        "assign", "fetch",
      "quality", "compare",    "write_parts", "halo",       "neighbours"};
  return std::find(kRepeatable.begin(), kRepeatable.end(), command) != kRepeatable.end();
}

}  // namespace

Result<Frame> Session::call_once(wire::Json request, const Retry& retry) {
  const auto command = wire::string_field(request, "command", 64);
  if (!command) return command.status();
  if (!request.contains("deadline_seconds")) request["deadline_seconds"] = retry.seconds_left();
  const std::uint64_t number = next_request();
  return exchange_frames(number, request_frame(number, request), *command, retry.deadline());
}

Result<Frame> Session::call(wire::Json request, double deadline_seconds) {
  const auto command = wire::string_field(request, "command", 64);
  if (!command) return command.status();
  Retry retry(deadline_seconds);
  if (*command == "shutdown") {  // not retry_until_deadline(): if the service is gone, it has shut down
    if (Status status = ensure(retry.deadline()); !status) return status;
    return call_once(std::move(request), retry);
  }
  bool sent = false;  // it may have been done
  const bool again = repeatable(*command) || (*command == "scene.create" && wire::is_true(request, "replace"));
  const bool frees = *command == "scene.create" || *command == "scene.drop";
  // Whoever holds the scene may be a solver whose machine has vanished, which the service notices in a while.
  const auto mend = [&](const Status& status) {
    sent = false;
    return frees && !held_here(status) && status.code() == Code::busy && options_.outlive &&
           wait(retry, status, fmt::format("'{}' to be possible: {}", *command, status.message())).ok();
  };
  const auto once = [&]() -> Result<Frame> {
    if (sent && !again)
      return Status(
          Code::unavailable,
          fmt::format("the connection to {} was lost; whether '{}' was done is not known", endpoint_text_, *command),
          "ask the service, then repeat it if need be");
    sent = true;
    auto answer = call_once(request, retry);
    if (!answer && told_goodbye_) sent = false;  // a service that ends has answered whatever it has begun
    return answer;
  };
  auto answer = retry_until_deadline(retry, once, mend);
  if (answer || !frees || !held_here(answer.status())) return answer;
  return Status(Code::busy, answer.status().message(),
                "that is this process, by another connection: close the scene there first, or open it again with the "
                "same client");
}

// Whether who has the scene is another client of this process, for which it would wait in vain.
bool Session::held_here(const Status& status) const {
  const auto pid = options_.name.rfind(" (pid ");
  return status.code() == Code::busy && pid != std::string::npos &&
         status.message().find(options_.name.substr(pid)) != std::string::npos;
}

}  // namespace rcb::client
