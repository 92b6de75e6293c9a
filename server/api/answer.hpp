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
  // Set if a part of the answer must be read from a file. It is called with the rest of the answer, whose own `later`
  // is empty then, reads that part without keeping the engine, and gives the whole to `take`, on any thread.
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
