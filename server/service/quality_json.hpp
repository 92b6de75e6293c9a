// What commands that compute a partition's quality share.
#pragma once

#include "common/partition/quality.hpp"
#include "server/service/context.hpp"

namespace rcb::service {

// Puts it into `json`, the answer's or an object in it; of several, long lists become rows of an array.
void put_quality(Response& response, wire::Json& json, const partition::Quality& quality);

// For work that asks whether to go on: as long as context.check_time() says so, whose last word `status` is.
partition::GoOn while_in_time(Context& context, Status& status);

}  // namespace rcb::service
