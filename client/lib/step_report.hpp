// A step report's JSON as the client's own type.
#pragma once

#include "client/lib/client.hpp"
#include "common/wire/message.hpp"

namespace rcb::client {

// Errors: protocol_error, naming the field.
Result<StepReport> read_report(const wire::Json& json);

}  // namespace rcb::client
