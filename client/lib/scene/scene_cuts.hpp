// The cuts of a scene, as Scene and MemberScene learn them: with the answer to a push that says which ones they know,
// or by asking.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "client/lib/session/session.hpp"
#include "common/cuts/cuts.hpp"

namespace rcb::client {

// A push's field "cuts_known".
wire::Json cuts_known_json(const std::optional<cuts::Cuts>& known);

// The cuts in force. Errors: also not_found (the scene has no positions yet), protocol_error.
Result<cuts::Cuts> ask_cuts(Session& session, const std::string& scene, const Retry& retry);

// The cuts after a step. answer, json: to its push, which named `known`. If the answer was lost, so that a
// repeated one came without them, they are asked for: then they are newer if another client has repartitioned since.
Result<cuts::Cuts> cuts_after_step(const Frame& answer, const wire::Json& json, const std::optional<cuts::Cuts>& known,
                                   Session& session, const std::string& scene, const Retry& retry);

}  // namespace rcb::client
