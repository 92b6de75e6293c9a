// Service: all of rcbd except sockets and MPI: (Comm, state, order) -> response. Every rank runs one.
//
// Invariants
// 1. Every rank executes the same orders in the same sequence; the changes by an order are the same on all ranks.
// 2. An order that fails changes nothing.
// 3. Only rank 0 returns the response; other ranks return an empty one.
#pragma once

#include <memory>
#include <vector>

#include "common/base/clock.hpp"
#include "common/comm/comm.hpp"
#include "common/wire/message.hpp"
#include "server/service/context/order.hpp"

namespace rcb::service {

class Service {
 public:
  Service(comm::Comm& comm, const Clock& clock, ServiceOptions options = {});
  ~Service();

  // Collective, except for commands that run on rank 0 alone (server/api/commands.hpp). request: the order's JSON, the
  // same on all ranks: "command" and the arguments of PROTOCOL.md. A push is {"command":"push", ...the fields of
  // push}; its slices are on rank 0 or, if the request has a field "staged", each on its own rank.
  Response execute(const wire::Json& request, std::vector<PushSlice> slices = {}, const OrderTerms& terms = {});

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace rcb::service
