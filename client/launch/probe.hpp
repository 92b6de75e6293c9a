// Tells whether a service listens at an endpoint, without using the protocol.
#pragma once

#include <string>

namespace rcb::launch {

enum class Answer {
  // The service sends anything on a new connection, or closes it, within the time. So a service that refuses the
  // connection, since it has as many clients as it takes, counts as alive.
  heard,
  silent,   // nobody listens there, or who does says nothing
  unasked,  // it couldn't be asked, which says nothing about the service; `why` tells what was in the way
};
Answer ask(const std::string& endpoint, double deadline_seconds, std::string& why);

}  // namespace rcb::launch
