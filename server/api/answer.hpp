// Answer: what an order gives back, on its way from the engine to the session that asked.
#pragma once

#include <functional>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "common/base/status.hpp"
#include "common/wire/message.hpp"
#include "server/scene/events.hpp"

namespace rcb::api {

struct Answer;
using TakeAnswer = std::function<void(Answer)>;

struct Answer {
  Status status;
  wire::Json json = wire::Json::object();
  std::vector<wire::Array> arrays;
  std::optional<scene::Change> change = {};  // what the order has done to its scene, if anything
  // Set if a part of the answer must be read from a file. It is called with the rest of the answer, whose own `later`
  // is empty then, reads that part without keeping the engine, and gives the whole to `take`, on any thread.
  std::function<void(Answer answer, TakeAnswer take)> later = {};
};

inline Answer failed(Status status) { return {std::move(status), wire::Json::object(), {}}; }
inline Answer done(wire::Json json) { return {{}, std::move(json), {}}; }

inline wire::Array make_array(std::string name, std::string dtype, std::uint64_t count, Buffer<std::byte> bytes) {
  return {std::move(name), std::move(dtype), {count}, std::move(bytes)};
}

template <typename T>
wire::Array make_array(std::string name, std::string dtype, std::span<const T> values) {
  Buffer<std::byte> bytes;
  bytes.assign(std::as_bytes(values));
  return make_array(std::move(name), std::move(dtype), values.size(), std::move(bytes));
}

// Gives the answer to `take` when it is complete.
inline void complete(Answer answer, TakeAnswer take) {
  if (const auto later = std::exchange(answer.later, {}))
    later(std::move(answer), std::move(take));
  else
    take(std::move(answer));
}

}  // namespace rcb::api
