// What comes with an order besides its request, what results from it, and the options of the service that executes it.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>

#include "common/base/status.hpp"
#include "common/files/side_thread.hpp"
#include "common/io/files/roots.hpp"
#include "common/wire/message.hpp"
#include "server/api/answer.hpp"
#include "server/api/slice.hpp"
#include "server/api/spare_memory.hpp"
#include "server/service/scene/no_skip.hpp"

namespace rcb::service {

using PushSlice = api::Slice;

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

struct ServiceOptions {
  NoSkip no_skip = {};  // the same on all ranks
  // Folders for clients' files. Shared with the thread that reads and writes them.
  std::shared_ptr<const io::Roots> roots = std::make_shared<const io::Roots>();
  std::uint64_t bulk_bytes_max = 0;  // of the points that `load` reads; 0: no limit
  // Shared with the threads that receive slices.
  std::shared_ptr<api::SpareMemory> spare = std::make_shared<api::SpareMemory>();
  SideThread::Start start_thread = {};  // for tests: starts the thread for clients' files
};

}  // namespace rcb::service
