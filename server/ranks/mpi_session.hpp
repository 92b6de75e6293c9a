// MpiSession: MPI from initialisation to finalisation, and the few texts that ranks exchange before the service runs.
//
// Invariants
// 1. MPI_THREAD_FUNNELED: every method is called by the thread that made the session.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "common/comm/comm.hpp"

namespace rcb::ranks {

class MpiSession {
 public:
  // Collective. Errors: unsupported (MPI without thread support).
  static Result<MpiSession> start(int* argc, char*** argv);
  MpiSession(MpiSession&&) noexcept;
  ~MpiSession();  // Collective: MPI_Finalize, unless finish() was called

  // Collective. All pages of the memory that ranks share, which MPI takes one by one as they are touched. Errors, the
  // same on all ranks: io_error (no room for them).
  Status allocate_shared_memory();

  int rank() const;            // Local.
  int size() const;            // Local.
  bool shares_memory() const;  // Local; whether every machine's ranks do (mpi_comm.hpp)
  comm::Comm& comm();          // Local.
  void progress();             // Local; of comm()'s messages (mpi_comm.hpp)
  // Collective. Returns rank 0's text on every rank.
  std::string share(const std::string& text);
  // Collective. Returns every rank's text, by rank, on every rank.
  std::vector<std::string> gather(const std::string& text);
  // Collective. Finalises MPI; a process that is not done after `seconds` is killed.
  void finish(unsigned seconds);

 private:
  struct State;
  explicit MpiSession(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

// Known from mpirun's environment variables before MPI is initialised. Local.
bool started_by_mpirun();
int rank_from_environment();  // 0 if mpirun didn't start this process

}  // namespace rcb::ranks
