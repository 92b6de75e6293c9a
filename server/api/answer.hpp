// Answer: what an order gives back, on its way from the engine to the session that asked.
#pragma once

#include <optional>
#include <vector>

#include "common/base/status.hpp"
#include "common/wire/message.hpp"
#include "server/api/snapshot.hpp"

namespace rcb::api {

struct Answer {
  Status status;
  wire::Json json = wire::Json::object();
  std::vector<wire::Array> arrays;
  std::optional<SceneChange> change = {};  // set if the order may have changed its scene
};

}  // namespace rcb::api
