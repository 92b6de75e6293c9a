// Shared by the commands that compute a partition's quality.
#pragma once

#include "common/partition/quality/quality.hpp"
#include "server/service/context/context.hpp"

namespace rcb::service {

// Puts the quality into `json`, which is the answer's or an object within it. Long lists of several qualities become
// rows of one array.
void put_quality(Response& response, wire::Json& json, const partition::Quality& quality);

// Returns a function that tells long work whether to go on, by context.check_time(); `status` gets its last result.
comm::GoOn while_in_time(Context& context, Status& status);

}  // namespace rcb::service
