// Reads the JSON of a step report into a StepReport.
#pragma once

#include "client/lib/client.hpp"
#include "common/wire/message.hpp"

namespace rcb::client {

// Errors: protocol_error, naming the field.
Result<StepReport> read_report(const wire::Json& json);

}  // namespace rcb::client
