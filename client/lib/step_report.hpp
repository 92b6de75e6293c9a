// A step report's JSON as the client's own type.
#pragma once

#include "client/lib/client.hpp"
#include "common/wire/message.hpp"

namespace rcb::client {

// Errors: protocol_error, naming the field.
Result<StepReport> read_report(const wire::Json& json);

// Of a step before which the particles had to be pushed again: its own words, not the service's.
void mark_recreated(StepReport& report);

}  // namespace rcb::client
