// The frames of a push that carry inserted and removed particles.
#pragma once

#include <cstdint>
#include <span>
#include <string>

#include "client/lib/scene/scene.hpp"

namespace rcb::client {

struct EditFrames {
  std::string bytes;
  int count = 0;
};

// begin: the arguments of push.begin. inserted: may be null.
EditFrames edit_frames(const wire::Json& begin, std::uint64_t request, std::span<const std::int64_t> removed,
                       const Insertion* inserted, int dims);

// Errors: invalid_argument. others: the positions pushed beside the insertion; weights: whether the scene has any.
Status check_insertion(const std::string& scene, const Insertion& in, const Positions& others, int dims, bool weights);

}  // namespace rcb::client
