// MpiSession: MPI from start to end, and the few words that ranks exchange before the service runs.
//
// Invariants
// 1. MPI_THREAD_FUNNELED: every method is called by the thread that made the session.
#pragma once

#include <memory>
#include <string>

#include "common/base/status.hpp"
#include "common/partition/comm.hpp"

namespace rcb::ranks {

class MpiSession {
 public:
  // Collective. Errors: unsupported (MPI without thread support).
  static Result<MpiSession> start(int* argc, char*** argv);
  MpiSession(MpiSession&&) noexcept;
  MpiSession& operator=(MpiSession&&) noexcept;
  ~MpiSession();  // Collective: MPI_Finalize, unless finish() was called

  int rank() const;         // Local.
  int size() const;         // Local.
  partition::Comm& comm();  // Local.
  // Collective. Rank 0's text, on every rank.
  std::string share(const std::string& text);
  // Collective. Ends MPI; a process that hangs in it is killed after `seconds`.
  void finish(unsigned seconds);

 private:
  struct State;
  explicit MpiSession(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

// What mpirun's environment says before MPI is up. Local.
bool started_by_mpirun();
int rank_from_environment();  // 0 where mpirun didn't start this process

}  // namespace rcb::ranks
