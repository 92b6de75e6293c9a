// Gathers the changes of all ranks on rank 0, for clients that follow the scene.
#pragma once

#include <cstdint>

#include "common/comm/comm.hpp"
#include "server/service/step/step.hpp"

namespace rcb::service {

inline constexpr std::uint64_t kChangesAtOnce = std::uint64_t{1} << 20U;

// Collective. On rank 0 `all` gets all ranks' changes, in ascending id. `local` may be in any order, has distinct ids,
// and is emptied. Large amounts are gathered in windows of ids, so that beside `all` rank 0 holds only one window.
//   most     upper bound of the number of all ranks' changes, the same on all ranks
//   at_once  most changes in a window
void gather_changes(comm::Comm& comm, PartChanges& local, std::uint64_t most, PartChanges& all,
                    std::uint64_t at_once = kChangesAtOnce);

}  // namespace rcb::service
