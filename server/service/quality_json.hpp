// The JSON of partition quality, by part.
#pragma once

#include "common/partition/quality.hpp"
#include "common/wire/message.hpp"

namespace rcb::service {

wire::Json quality_json(const partition::Quality& quality);

}  // namespace rcb::service
