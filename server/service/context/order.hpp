// What comes with an order besides its request, and what results from it.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/base/status.hpp"
#include "common/wire/message.hpp"
#include "server/api/answer.hpp"
#include "server/api/slice.hpp"

namespace rcb::service {

using PushSlice = api::Slice;

// What an order hands back to the socket side: memory into which the scene's next push is to be received. Without
// buffers it says that memory kept for the scene so far is to be freed.
struct Spare {
  std::string scene;
  std::vector<Buffer<std::byte>> buffers;
};

using Response = api::Answer;

// The orders that wait behind the one being executed.
class WaitingOrders {
 public:
  virtual ~WaitingOrders() = default;
  // On rank 0: the number of the newest waiting order that may be executed now; 0 if there is none.
  virtual std::uint64_t newest() = 0;
  // Executes the waiting orders up to that number, the same ones on every rank. Collective.
  virtual void execute(std::uint64_t newest) = 0;
};

// Further terms of an order. Only rank 0's values are used, except for `waiting`.
struct OrderTerms {
  double received_seconds = 0;                                   // time a push took to arrive; for the report
  double seconds_left = wire::kDeadlineSecondsMax;               // until the client's deadline, when the order begins
  std::shared_ptr<const std::atomic<bool>> cancelled = nullptr;  // set once nobody waits for the answer; may be null
  // On every rank: the waiting orders that a long order gives way to (Context::check_time); nullptr: none.
  WaitingOrders* waiting = nullptr;
};

}  // namespace rcb::service
