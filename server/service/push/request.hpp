// An order to push, as the service reads it. That it suits the scene was checked by rank 0's ledger, before its rows
// came (server/net/push): step, number of particles, whether there are ids and weights.
#pragma once

#include <vector>

#include "common/base/status.hpp"
#include "common/wire/message.hpp"
#include "server/api/push.hpp"
#include "server/scene/policy.hpp"
#include "server/service/scene/scene.hpp"

namespace rcb::service {

// What all ranks know of a block of the step.
struct Block {
  int seat = 0;
  std::uint64_t n = 0;
  api::Way way = api::Way::endpoint;
  bool is_float32 = false;
  std::vector<std::uint64_t> counts;  // by rank, if its client has said which rows are whose
};

struct PushRequest : api::Push {
  scene::DecisionTerms terms;  // of rank 0's ledger
  int seats = 1;               // that bring the step together
  std::vector<Block> blocks;   // those that have rows, by ascending seat
  // Of mix64(id), of the last step, where counts have brought other particles than the ranks hold. Rank 0's ledger has
  // compared their number.
  std::optional<std::uint64_t> counted_ids;

  // The rows are those of the particles that the ranks hold, in shared memory.
  bool of_held(const Scene& scene) const {
    return !counted_ids && scene.step && scene.n > 0 && blocks.size() == 1 &&
           blocks.front().way == api::Way::shared_memory && blocks.front().counts.empty();
  }
};

// Local. Errors: invalid_argument.
Result<PushRequest> read_order(const wire::Json& request, int ranks);

}  // namespace rcb::service
