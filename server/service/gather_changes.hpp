// The changes of all ranks, put together on rank 0 for whoever follows the scene.
#pragma once

#include <cstdint>

#include "common/partition/comm.hpp"
#include "server/service/step.hpp"

namespace rcb::service {

inline constexpr std::uint64_t kChangesAtOnce = std::uint64_t{1} << 20U;

// On rank 0: all ranks' changes in ascending id; `local` is used up, in any order but with distinct ids. Many come in
// windows of ids, so that beside `all` rank 0 holds no more than one of them. Collective.
//   most     no fewer than there are on all ranks together, the same on all of them
//   at_once  how many of them a window has at most
void gather_changes(partition::Comm& comm, PartChanges& local, std::uint64_t most, PartChanges& all,
                    std::uint64_t at_once = kChangesAtOnce);

}  // namespace rcb::service
