// Runs a test body on ranks: with threads for each of 1, 2, 3, 4, 7 ranks in the thread programs, once on the
// ranks that mpirun gave in the MPI ones. The same test source serves both.
#pragma once

#include <functional>
#include <vector>

#include "common/comm/comm.hpp"

namespace rcb::testing {

// body runs on every rank at once; EXPECT_ is allowed in it, ASSERT_ only returns from the body of its rank (the
// others would wait for ever if it stands before a collective).
void on_ranks(const std::function<void(comm::Comm&)>& body);
// With threads: these rank counts. On MPI: what mpirun gave, whatever is asked.
void on_ranks(const std::vector<int>& rank_counts, const std::function<void(comm::Comm&)>& body);

// As the first, and on MPI once more with a Comm that sends in small pieces, as messages beyond 2^31 bytes go.
void on_every_comm(const std::function<void(comm::Comm&)>& body);

// Whether ranks are threads of this process: then it sees all of them, and several rank counts.
bool ranks_are_threads();

}  // namespace rcb::testing
