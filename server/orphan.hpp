// What a rank does when its mpirun dies, as it does when the supervisor is killed: nobody is left to clean up after it.
#pragma once

namespace rcb::server {

// From now on this process ends with its mpirun. However it ends but for SIGKILL, it removes what it has in the file
// system: its sockets and, on rank 0, the job's folder (Open MPI's session files and the ranks' shared memory). A
// stopped process does so too: the kernel continues it, as it does with every process group that nobody is left to
// continue.
void end_with_mpirun(int rank);

// For a process that is about to end in disorder. Safe in a signal handler.
void remove_traces() noexcept;

// This process is about to end as told: it has removed its sockets, and the job's folder is for mpirun to leave first.
void end_in_order();

}  // namespace rcb::server
