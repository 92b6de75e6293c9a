// Service: the whole of rcbd without sockets and MPI. Runs alike on every rank: (Comm, state, order) -> response.
//
// Invariants
// 1. Every rank executes the same orders in the same sequence; what an order changes is the same on all ranks.
// 2. An order that fails changes nothing.
// 3. The response is complete on rank 0 alone; elsewhere it is empty.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/base/clock.hpp"
#include "common/base/status.hpp"
#include "common/partition/comm.hpp"
#include "common/wire/message.hpp"
#include "server/api/snapshot.hpp"
#include "server/service/no_skip.hpp"

namespace rcb::io {
class Roots;
}

namespace rcb::service {

class Arrival;
class Loans;

// The particles a client sent for one rank, arrays x y z (w) (id).
struct PushSlice {
  int rank = 0;
  std::uint64_t count = 0;
  std::vector<wire::Array> arrays;
  std::shared_ptr<const Arrival> arrival = nullptr;  // what was seen of it as it came; may be null
};

// Memory that the next push of a scene may be received into; none: what is kept for it is to be freed.
struct Spare {
  std::string scene;
  std::vector<Buffer<std::byte>> buffers;
};

struct Response {
  Status status;
  wire::Json json = wire::Json::object();
  std::vector<wire::Array> arrays;
  std::optional<api::SceneChange> change = {};  // where the order may have changed its scene
};

// The orders that have arrived behind the one that is being executed.
class WaitingOrders {
 public:
  virtual ~WaitingOrders() = default;
  // Rank 0's: the newest that may be executed now; 0: none.
  virtual std::uint64_t newest() = 0;
  // Executes those up to there, on every rank the same. Collective.
  virtual void execute(std::uint64_t newest) = 0;
};

// What comes with an order beside its request. Of rank 0's alone counts what is said here.
struct OrderTerms {
  double received_seconds = 0;                                   // how long a push took to arrive; for the report
  double seconds_left = wire::kDeadlineSecondsMax;               // to the client's deadline, when the order is begun
  std::shared_ptr<const std::atomic<bool>> cancelled = nullptr;  // set once nobody waits for the answer; may be null
  // On every rank: those that an order that may last gives way to (Context::check_time); null: none.
  WaitingOrders* waiting = nullptr;
};

struct ServiceOptions {
  NoSkip no_skip = {};  // the same on all ranks
  // What the scenes lend to the passes over arriving slices (it outlives the service); null: nothing.
  Loans* loans = nullptr;
  const io::Roots* roots = nullptr;  // where files may be read and written (it outlives the service); null: nowhere
  // Rank 0's: step reports kept in memory, all scenes together, and where older ones go, a directory of the service's
  // own (make_report_directory); empty: nowhere.
  std::size_t keep_reports = 100'000;
  std::string report_directory = {};
};

class Service {
 public:
  Service(partition::Comm& comm, const Clock& clock, ServiceOptions options = {});
  ~Service();

  // Collective. request: the order's JSON, the same on all ranks, "command" and the arguments of PROTOCOL.md.
  // A push arrives as {"command":"push", ...the fields of push.begin} with its slices on rank 0 or, where the request
  // has a field "staged", with each rank's slice on that rank.
  // Commands that run on rank 0 alone (server/api/commands.hpp) aren't collective.
  Response execute(const wire::Json& request, std::vector<PushSlice> slices = {}, const OrderTerms& terms = {});

  // Local. What the orders since the last call gave up, in their order.
  std::vector<Spare> take_spares();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace rcb::service
