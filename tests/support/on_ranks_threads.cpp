// on_ranks with threads for ranks.
#include <string>

#include <gtest/gtest.h>

#include "tests/support/on_ranks.hpp"
#include "tests/support/thread_comm.hpp"

namespace rcb::testing {

void on_ranks(const std::function<void(comm::Comm&)>& body) { on_ranks({1, 2, 3, 4, 7}, body); }

void on_ranks(const std::vector<int>& rank_counts, const std::function<void(comm::Comm&)>& body) {
  for (const int ranks : rank_counts) {
    SCOPED_TRACE("on " + std::to_string(ranks) + " ranks");
    ThreadWorld world(ranks);
    run_threads(ranks, [&](int rank) {
      ThreadComm comm(world, rank);
      body(comm);
    });
  }
}

void on_every_comm(const std::function<void(comm::Comm&)>& body) { on_ranks(body); }

bool ranks_are_threads() { return true; }

}  // namespace rcb::testing
