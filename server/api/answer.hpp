// Answer: what an order gives back, on its way from the engine to the session that asked.
#pragma once

#include <functional>
#include <optional>
#include <utility>
#include <vector>

#include "common/base/status.hpp"
#include "common/wire/message.hpp"
#include "server/api/snapshot.hpp"

namespace rcb::api {

struct Answer;
using TakeAnswer = std::function<void(Answer)>;

struct Answer {
  Status status;
  wire::Json json = wire::Json::object();
  std::vector<wire::Array> arrays;
  std::optional<SceneChange> change = {};  // set if the order may have changed its scene
  // Set where a part of the answer is in a file: completes the answer beside the engine, and gives it to `take` from
  // any thread. Always takes the answer without `later`.
  std::function<void(Answer answer, TakeAnswer take)> later = {};
};

// Gives the answer to `take` when it is complete.
inline void complete(Answer answer, TakeAnswer take) {
  if (const auto later = std::exchange(answer.later, {}))
    later(std::move(answer), std::move(take));
  else
    take(std::move(answer));
}

}  // namespace rcb::api
