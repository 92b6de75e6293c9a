// Tells whether a service listens at an endpoint, without using the protocol.
#pragma once

#include <string>

namespace rcb::launch {

// True if the service sends anything on a new connection, or closes it, within the time. So a service
// that refuses the connection, since it has as many clients as it takes, counts as alive.
bool answers(const std::string& endpoint, double deadline_seconds);

}  // namespace rcb::launch
