// Where rcbd and mpirun are, and the arguments of mpirun, the same for every mpirun of the project.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.hpp"

namespace rcb::launch {

// The number of cores that this process may use, at most 8.
int default_ranks();

// PATH; where that isn't set, what shells take for it.
std::string path_variable();

// rcbd in RCBD_BIN_DIR if that is set; else beside this program, then in PATH. Errors: not_found, with the places
// searched.
Result<std::string> find_rcbd();

// The machines of a job, as mpirun takes them. All empty: this one.
struct Hosts {
  std::string list;  // A:4,B:4
  std::string file;  // a hostfile of Open MPI
  // Of a batch job. Those of a Slurm job mpirun finds by itself.
  int job_machines = 0;
  int job_tasks = 0;  // 0: not said
  std::string
      interface;  // for the traffic between ranks: an interface (eth0) or an IPv4 network (10.0.0.0/8); empty: any

  bool several() const { return !list.empty() || !file.empty() || job_machines > 1; }
  // How many ranks the list, the file or the batch job has room for. Errors: invalid_argument, not_found.
  Result<int> slots() const;
};

// The machines of the Slurm or PBS job that this program is in. All empty: in none.
Hosts hosts_of_job();
// Errors: invalid_argument: the Slurm job of this environment isn't on this machine.
Status check_job_is_here();
// Whether Slurm's list of machines, such as "a[01-03,7],b", has this one.
bool has_machine(std::string_view list, std::string_view machine);

struct JobSpec {
  std::string endpoint;  // unix:PATH or HOST:PORT
  std::string data_dir;
  int ranks = 1;
  Hosts hosts;                                 // where the ranks run
  std::string folder;                          // for Open MPI's session files; empty: its default place
  bool memory_in_folder = false;               // ranks share memory through files, System V's limits being too low
  std::vector<std::string> service_arguments;  // further options of rcbd
  // Another MPI program with its arguments; empty: rcbd on `endpoint` with `data_dir`.
  std::vector<std::string> command;
};

// The complete command line of mpirun. --bind-to none, since a rank bound to one core would have both its threads
// there; --oversubscribe, since ranks outnumber cores on small machines. On one machine only vader and self as
// transports, so that ranks open no port; on several tcp besides, unless OMPI_MCA_btl says otherwise.
Result<std::vector<std::string>> mpirun_arguments(const JobSpec& spec);

}  // namespace rcb::launch
