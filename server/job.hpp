// What a rank has to do with the job that it is part of, as the launcher has started it: it says when the service is
// up, and leaves nothing when the job ends in disorder.
#pragma once

namespace rcb::server {

// From now on this process ends with its mpirun. However it ends but for SIGKILL, it removes what it has in the file
// system: its sockets and, on rank 0, the job's folder (Open MPI's session files and the ranks' shared memory). A
// stopped process does so too: the kernel continues it, as it does with every process group that nobody is left to
// continue.
void end_with_mpirun(int rank);

// For a process that is about to end in disorder. Safe in a signal handler.
void remove_traces() noexcept;

// Rank 0: the service answers from now on; the launcher finds kReadyFile in the job's folder.
void say_ready();

// This process is about to end as told: it has removed its sockets, and the job's folder is for mpirun to leave first.
void end_in_order();

}  // namespace rcb::server
