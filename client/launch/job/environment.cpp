#include "client/launch/job/environment.hpp"

#include <algorithm>
#include <cstdlib>
#include <initializer_list>
#include <string_view>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <ifaddrs.h>
#include <net/if.h>
#include <sys/socket.h>
#include <unistd.h>

#include "common/files/endpoint_lock.hpp"
#include "common/files/paths.hpp"
#include "common/files/process_id.hpp"

extern char** environ;

namespace rcb::launch {
namespace {

constexpr std::string_view kForOpenMpi = "OMPI_MCA_";

bool starts_with_any(std::string_view entry, std::initializer_list<std::string_view> prefixes) {
  return std::any_of(prefixes.begin(), prefixes.end(),
                     [&](std::string_view prefix) { return entry.starts_with(prefix); });
}

// Whether an environment entry is left out for the job: those of an outer MPI job, by which mpirun would take itself
// for one of its ranks, those that say otherwise than mpirun's options where ranks go, and variables that the job gets
// anew or must not have.
bool excluded_from_job(std::string_view entry, const Hosts& hosts) {
  if (starts_with_any(entry, {"PMIX_", "OMPI_COMM_WORLD_", "OMPI_MCA_ess", "OMPI_MCA_orte_", "OMPI_MCA_pmix",
                              "OMPI_MCA_rmaps_", "OMPI_UNIVERSE", "OMPI_APP_CTX", "OMPI_FIRST_RANKS", "OMPI_NUM_APP",
                              "ORTE_", "RCBD_ENDPOINT=", "RCBD_RESTARTED=", "RCBD_LAUNCHER_HOST=", "RCBD_SUPERVISOR=",
                              "RCBD_JOB_FOLDER=", "SLURM_EXPORT_ENV=", "SLURM_OVERLAP="}))
    return true;
  // On one machine ranks need no network, whatever is said of it: it is for other jobs.
  return !hosts.several() && starts_with_any(entry, {"TMPDIR=", "OMPI_MCA_btl", "OMPI_MCA_mtl", "OMPI_MCA_oob",
                                                     "OMPI_MCA_plm", "OMPI_MCA_pml", "OMPI_MCA_ras"});
}

bool has_ipv4() {
  ifaddrs* all = nullptr;
  if (::getifaddrs(&all) != 0) return true;  // not known
  bool found = false;
  for (const ifaddrs* each = all; each != nullptr; each = each->ifa_next)
    found =
        found || (each->ifa_addr != nullptr && each->ifa_addr->sa_family == AF_INET && (each->ifa_flags & IFF_UP) != 0);
  ::freeifaddrs(all);
  return found;
}

}  // namespace

std::vector<std::string> job_environment(const JobSpec& spec, bool restarted) {
  std::vector<std::string> environment;
  for (char** entry = environ; *entry != nullptr; ++entry)
    if (!excluded_from_job(*entry, spec.hosts)) environment.emplace_back(*entry);
  if (std::getenv("PATH") == nullptr)
    environment.push_back("PATH=" + path_variable());  // which mpirun can't do without
  // srun hands TMPDIR to the other machines, where Slurm would make such a folder and leave it behind; so where there
  // are several, mpirun gets an option instead (programs.cpp).
  if (!spec.hosts.several()) environment.push_back("TMPDIR=" + spec.folder);
  // In a Slurm job mpirun starts its daemons on the other machines by srun, which takes options from here. They overlap
  // other steps: else they keep their cores for themselves as long as the service runs, and a solver in the same job
  // waits for them. They get the whole environment, also in a job that was submitted with --export=NONE.
  environment.emplace_back("SLURM_OVERLAP=1");
  environment.emplace_back("SLURM_EXPORT_ENV=ALL");
  environment.push_back(fmt::format("{}={}", kJobFolderVariable, spec.folder));
  environment.push_back(fmt::format("{}={}", kSupervisorVariable, ProcessId::self().text()));
  environment.push_back(fmt::format("{}={}", kLauncherHostVariable, host_name()));
  if (restarted) environment.emplace_back("RCBD_RESTARTED=1");
  return environment;
}

std::string odd_surroundings(const Hosts& hosts) {
  if (!has_ipv4())
    return "Open MPI needs an IPv4 address, and this machine has none, not even that of its loopback interface (as "
           "root: "
           "ip link set lo up)";
  std::vector<std::string> heeded;
  for (char** entry = environ; *entry != nullptr; ++entry)
    if (std::string_view(*entry).starts_with(kForOpenMpi) && !excluded_from_job(*entry, hosts))
      heeded.emplace_back(*entry);
  const char* const home = std::getenv("HOME");
  const std::string settings = join_path(home == nullptr ? "" : home, ".openmpi/mca-params.conf");
  if (::access(settings.c_str(), R_OK) == 0) heeded.push_back(settings);
  if (!heeded.empty()) return fmt::format("Open MPI heeds {}: try without", fmt::join(heeded, ", "));
  const char* const job = std::getenv("SLURM_JOB_ID");
  if (job != nullptr && hosts.job_machines > 1)
    return fmt::format("if job {} of SLURM_JOB_ID has ended, or is elsewhere, unset that", job);
  return {};
}

}  // namespace rcb::launch
