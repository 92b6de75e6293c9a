// on_ranks on the ranks that mpirun gave: once, whatever rank counts are asked.
#include <gtest/gtest.h>
#include <mpi.h>

#include "server/ranks/mpi_comm.hpp"
#include "tests/support/on_ranks.hpp"

namespace rcb::testing {

void on_ranks(const std::function<void(comm::Comm&)>& body) { on_ranks({}, body); }

void on_ranks(const std::vector<int>&, const std::function<void(comm::Comm&)>& body) {
  ranks::MpiComm comm(MPI_COMM_WORLD);
  body(comm);
}

void on_every_comm(const std::function<void(comm::Comm&)>& body) {
  on_ranks(body);
  using Ways = ranks::MpiComm::Ways;
  EXPECT_TRUE(ranks::MpiComm(MPI_COMM_WORLD).shares_memory());
  for (const Ways& ways :
       {Ways{.shared_memory = false}, Ways{.rank_without_memory = 1},
        Ways{.shared_memory = false, .message_bytes_max = 24}, Ways{.ranks_of_machine = 1}, Ways{.ranks_of_machine = 2},
        Ways{.ranks_of_machine = 3}, Ways{.shared_memory = false, .ranks_of_machine = 3},
        Ways{.shared_memory = false, .tell_all_ranks_max = 0}}) {
    ranks::MpiComm comm(MPI_COMM_WORLD, ways);
    const bool each_can = ways.shared_memory && ways.rank_without_memory < 0;
    EXPECT_EQ(comm.shares_memory(), each_can || comm.size() == 1);
    body(comm);
  }
}

bool ranks_are_threads() { return false; }

}  // namespace rcb::testing
