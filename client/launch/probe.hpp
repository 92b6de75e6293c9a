// Whether anybody serves an endpoint, without a word of the protocol.
#pragma once

#include <string>

namespace rcb::launch {

// A service speaks first: true if it says anything to a new connection, or closes it, within the time. So one that
// refuses everybody, since it has as many clients as it takes, counts as one that lives.
bool answers(const std::string& endpoint, double deadline_seconds);

}  // namespace rcb::launch
