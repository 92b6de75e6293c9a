// The frames of a push that carry inserted and removed particles.
#pragma once

#include <string>

#include "client/lib/scene.hpp"

namespace rcb::client {

struct EditFrames {
  std::string bytes;
  int count = 0;
};

// begin: the arguments of push.begin.
EditFrames edit_frames(const wire::Json& begin, std::uint64_t request, const StepRequest& ask, int dims);

}  // namespace rcb::client
