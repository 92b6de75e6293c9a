// Programs and arguments: where rcbd and mpirun are, and how mpirun is called. Every mpirun of the project is called
// with these arguments.
#pragma once

#include <string>
#include <vector>

#include "common/base/status.hpp"

namespace rcb::launch {

// As many ranks as this process may use cores, at most 8.
int default_ranks();

// rcbd in RCBD_BIN_DIR, where that is set; else beside this program, then in PATH. Errors: not_found, naming the
// places.
Result<std::string> find_rcbd();
// Errors: not_found.
Result<std::string> find_in_path(const std::string& program);

struct JobSpec {
  std::string endpoint;  // unix:PATH or HOST:PORT
  std::string data_dir;
  int ranks = 1;
  std::string folder;                          // for the ranks' shared memory; empty: Open MPI's default place
  std::vector<std::string> service_arguments;  // more of rcbd's options, as given to it
  // Another MPI program with its arguments; empty: rcbd on `endpoint` with `data_dir`.
  std::vector<std::string> command;
};

// mpirun and everything after it. --bind-to none, since a rank bound to one core would put its two threads there;
// --oversubscribe, since ranks outnumber cores on small machines; vader and self alone, so that ranks open no port.
Result<std::vector<std::string>> mpirun_arguments(const JobSpec& spec);

}  // namespace rcb::launch
