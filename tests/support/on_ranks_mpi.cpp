// on_ranks on the ranks that mpirun gave: once, whatever rank counts are asked.
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
  ranks::MpiComm pieces(MPI_COMM_WORLD, 24);
  body(pieces);
  ranks::MpiComm apart(MPI_COMM_WORLD, ranks::MpiComm::kMessageBytesMax, true);
  body(apart);
  ranks::MpiComm tree(MPI_COMM_WORLD, ranks::MpiComm::kMessageBytesMax, false, 0);
  body(tree);
}

bool ranks_are_threads() { return false; }

}  // namespace rcb::testing
