// Engine: all that the socket side needs of the ranks' engine threads. The real one executes an order on all ranks; in
// tests a function answers.
//
// Invariants
// 1. Orders of one scene are executed in the order of submit(), except for some that only read (order_queue.hpp).
// 2. Every submitted order is answered exactly once, and the answer says how the order has changed its scene.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "common/wire/message.hpp"
#include "server/api/answer.hpp"
#include "server/api/slice.hpp"

namespace rcb::net {

using api::Slice;

struct Order {
  wire::Json request;  // "command" and its arguments
  std::string text;    // `request` as text, at most kJsonBytesMax bytes
  std::vector<Slice> slices;
  double received_seconds = 0;
  double deadline_seconds = 60;
  // Set when nobody waits for the answer any more, so that a long command may end early. May be null.
  std::shared_ptr<const std::atomic<bool>> cancelled;
};

using api::Answer;

class Engine {
 public:
  virtual ~Engine() = default;
  // Called on the I/O thread. `done` may be called from any thread, also before submit() has returned.
  virtual void submit(Order order, std::function<void(Answer)> done) = 0;
  // Called on the I/O thread when `cancelled` of an order has been set: it may be answered at once if it hasn't begun.
  virtual void drop_cancelled() {}
};

}  // namespace rcb::net
