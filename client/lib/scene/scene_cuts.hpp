// What a Scene knows of its scene's cuts: every push says which ones it knows, and the answer tells new ones.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>

#include "client/lib/session/session.hpp"
#include "common/cuts/cuts.hpp"

namespace rcb::client {

struct SceneCuts {
  std::optional<cuts::Cuts> known;  // after the last step whose answer told them

  // The field "cuts_known" of a push.
  wire::Json known_json() const;
  // The cuts after a step. answer, json: to its push; epoch: after it. A repeated answer may come without them; then
  // there are none, and those that are asked for are newer if another client has repartitioned since.
  Result<std::optional<cuts::Cuts>> after_step(const Frame& answer, const wire::Json& json, std::uint64_t epoch) const;
  // One attempt: those in force.
  static Result<cuts::Cuts> ask(Session& session, const std::string& scene, const Retry& retry);
  // Those known, or those in force if the ones after the step that began `epoch` aren't known. hold: opens the scene.
  // Errors: also not_found (the scene has no positions yet).
  Result<cuts::Cuts> current(std::uint64_t epoch, Session& session, const std::string& scene, double deadline_seconds,
                             const std::function<Status(const Retry&)>& hold);
};

}  // namespace rcb::client
