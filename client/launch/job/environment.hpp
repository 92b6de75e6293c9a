// What mpirun and its ranks inherit from the environment, and what in it may keep them from starting.
#pragma once

#include <string>
#include <vector>

#include "client/launch/job/programs.hpp"

namespace rcb::launch {

// The environment of a job, an entry a variable.
std::vector<std::string> job_environment(const JobSpec& spec, bool restarted);

// What around a job that didn't start may be why, and what to do then, for a hint; empty if there is nothing odd:
// settings that Open MPI heeds, a Slurm job that may be another's, a machine without an IPv4 address.
std::string odd_surroundings(const Hosts& hosts);

}  // namespace rcb::launch
