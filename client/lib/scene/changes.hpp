// What the pushes of a Scene and of a member have in common: checks, and the frames that carry inserted and removed
// particles.
#pragma once

#include <cstdint>
#include <optional>
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
                       const Insertion* inserted);

// The error of a push whose arguments can't be right.
Status wrong_push(const std::string& scene, const std::string& message, std::string hint);
// Errors of these: invalid_argument. That positions have the scene's dims, an array for each axis, and a stride.
Status check_arrays(const std::string& scene, const Positions& positions, int dims);
Status check_terms(const std::string& scene, std::optional<std::int64_t> step, std::optional<double> step_seconds,
                   double deadline_seconds, int threads);
// others: the positions pushed beside the insertion; weights: whether the scene has any.
Status check_insertion(const std::string& scene, const Insertion& in, const Positions& others, int dims, bool weights);

}  // namespace rcb::client
