// A rank's part in the job that the launcher started: it reports when the service is up, and cleans up if the job ends
// in disorder.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

namespace rcb::server {

// From now on this process ends with its mpirun. However it ends, except by SIGKILL, it removes its files: its sockets
// and, on rank 0, the job's folder (Open MPI's session files). This holds for a stopped
// process too: the kernel continues a stopped process group once it is orphaned.
void end_with_mpirun(int rank);
// From now on a signal that tells of a bug or of destroyed memory (SIGSEGV, SIGABRT and their like) ends this process
// within seconds, with a line and a backtrace on standard error. To be called after MPI_Init: Open MPI's own handlers
// allocate memory, and wait for ever where the fault came in the middle of an allocation.
void end_at_faults(int rank);
// As many files as the system lets this process open: every client is one.
void raise_open_files_limit();

// How many connections of each kind this process takes, so that it never runs out of descriptors: then it could not
// even tell its supervisor that all is well.
struct ConnectionLimits {
  int sessions = 0;         // and as many data connections
  std::size_t waiting = 0;  // at each listener, before their hello
};
// Computed from what the limit for open files leaves beside those that are open now.
ConnectionLimits connection_limits(int ranks);

// The job's folder, which the launcher removes at the end; /tmp for a job that it didn't start.
std::string job_folder();

// Removes these files; for a process that is about to end in disorder. Safe in a signal handler.
void remove_traces() noexcept;

// Rank 0: announces that the service answers, by making kReadyFile in the job's folder, where the launcher looks for
// it. The file has the endpoints, one a line, as they were bound: the launcher asks there whether the service lives.
void say_ready(const std::vector<std::string>& endpoints);

// Switches off the clean-up at exit, for a process that ends on command: it has removed its sockets, and the launcher
// removes the job's folder after mpirun has ended.
void end_in_order();

}  // namespace rcb::server
