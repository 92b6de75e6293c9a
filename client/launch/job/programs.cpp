#include "client/launch/job/programs.hpp"

#include <algorithm>
#include <charconv>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <set>
#include <sstream>
#include <tuple>

#include <fmt/format.h>
#include <sched.h>
#include <unistd.h>

#include "common/files/paths.hpp"

extern char** environ;

namespace rcb::launch {
namespace {

namespace fs = std::filesystem;

constexpr int kDefaultRanksMax = 8;

std::string absolute_text(const fs::path& path) {
  std::error_code error;  // the working directory may be gone
  const fs::path found = fs::absolute(path, error);
  return (error ? path : found).string();
}

bool runnable(const fs::path& path) {
  std::error_code error;
  return fs::is_regular_file(path, error) && access(path.c_str(), X_OK) == 0;
}

// Path of the program in a colon-separated list of folders; empty if none has it.
std::string search(const std::string& folders, const std::string& program) {
  std::size_t begin = 0;
  while (begin <= folders.size()) {
    const std::size_t end = std::min(folders.find(':', begin), folders.size());
    const std::string folder = folders.substr(begin, end - begin);
    const fs::path path = fs::path(folder.empty() ? "." : folder) / program;
    if (runnable(path)) return absolute_text(path);
    begin = end + 1;
  }
  return {};
}

// What says where the service is rather than how it works.
const std::set<std::string> kOfThisMachine{"RCBD_ENDPOINT",      "RCBD_BIN_DIR",     "RCBD_TOKEN",
                                           "RCBD_TOKEN_FILE",    kJobFolderVariable, "RCBD_SUPERVISOR",
                                           kLauncherHostVariable};

void add_hosts(const Hosts& hosts, std::vector<std::string>& arguments) {
  if (!hosts.list.empty()) arguments.insert(arguments.end(), {"--host", hosts.list});
  if (!hosts.file.empty()) arguments.insert(arguments.end(), {"--hostfile", hosts.file});
  if (std::getenv("OMPI_MCA_btl") == nullptr) arguments.insert(arguments.end(), {"--mca", "btl", "vader,tcp,self"});
  // What a remote shell doesn't bring along.
  arguments.insert(arguments.end(), {"-x", kLauncherHostVariable});
  for (char** entry = environ; *entry != nullptr; ++entry)
    if (const std::string_view text(*entry); text.starts_with("RCBD_"))
      if (const std::string name(text.substr(0, text.find('='))); !kOfThisMachine.contains(name))
        arguments.insert(arguments.end(), {"-x", name});
  if (hosts.interface.empty()) return;
  for (const char* part : {"btl_tcp_if_include", "oob_tcp_if_include"})
    arguments.insert(arguments.end(), {"--mca", part, hosts.interface});
}

// The number behind "slots=" or a colon; 1 if there is none.
Result<int> slots_in(const std::string& host, const std::string& mark) {
  std::size_t at = host.find(mark);
  if (at != std::string::npos && at > 0 && host[at - 1] == '_') at = host.find(mark, at + 1);  // max_slots
  if (at == std::string::npos) return 1;
  const char* begin = host.data() + at + mark.size();
  int slots = 0;
  const auto [end, fault] = std::from_chars(begin, host.data() + host.size(), slots);
  if (fault != std::errc() || slots < 1 ||
      (end != host.data() + host.size() && *end != ' ' && *end != '\t' && *end != '\r'))
    return Status(Code::invalid_argument, fmt::format("'{}' doesn't say how many ranks it has room for", host),
                  "for example a:4,b:4, or in a hostfile: a slots=4");
  return slots;
}

std::string variable(const char* name) {
  const char* value = std::getenv(name);
  return value == nullptr ? "" : value;
}

// Slurm's "4(x2),3", tasks on two machines and on a third: the number of machines and of tasks; {0, 0} if it is odd.
std::pair<int, int> machines_and_tasks(const std::string& text) {
  int machines = 0;
  int tasks = 0;
  std::istringstream parts(text);
  for (std::string part; std::getline(parts, part, ',');) {
    int each = 0;
    int times = 1;
    const char* const end = part.data() + part.size();
    auto [at, fault] = std::from_chars(part.data(), end, each);
    if (fault == std::errc() && std::string_view(at, end).starts_with("(x"))
      at = std::from_chars(at + 2, end, times).ptr + 1;
    if (fault != std::errc() || at != end || each < 1 || times < 1) return {0, 0};
    machines += times;
    tasks += each * times;
  }
  return {machines, tasks};
}

// Whether the machine's name goes on with one of these numbers, "01-03,7", and then with the rest of a list's item.
bool has_number(std::string_view numbers, std::string_view rest, std::string_view machine) {
  const std::size_t digits = std::min(machine.find_first_not_of("0123456789"), machine.size());
  const auto number = [](std::string_view text) {
    int value = -1;
    std::from_chars(text.data(), text.data() + text.size(), value);
    return value;
  };
  const int own = number(machine.substr(0, digits));
  for (std::size_t begin = 0; begin <= numbers.size() && digits > 0;) {
    const std::size_t end = std::min(numbers.find(',', begin), numbers.size());
    const std::string_view range = numbers.substr(begin, end - begin);
    const std::string_view first = range.substr(0, range.find('-'));
    const std::string_view last = range.substr(range.find('-') == std::string_view::npos ? 0 : first.size() + 1);
    if (digits >= first.size() && own >= number(first) && own <= number(last))
      return has_machine(rest, machine.substr(digits));
    begin = end + 1;
  }
  return false;
}

}  // namespace

std::string path_variable() {
  const char* path = std::getenv("PATH");
  return path != nullptr ? path : "/usr/local/bin:/usr/bin:/bin";
}

bool has_machine(std::string_view list, std::string_view machine) {
  const std::size_t bracket = list.find('[');
  const std::size_t end = std::min(list.find(','), list.size());
  if (bracket >= end) {
    if (list.substr(0, end) == machine) return true;
    return end < list.size() && has_machine(list.substr(end + 1), machine);
  }
  const std::size_t closing = std::min(list.find(']'), list.size());
  const std::size_t next = std::min(list.find(',', closing), list.size());
  const std::string_view rest = list.substr(std::min(closing + 1, next), next - std::min(closing + 1, next));
  if (machine.starts_with(list.substr(0, bracket)) &&
      has_number(list.substr(bracket + 1, closing - bracket - 1), rest, machine.substr(bracket)))
    return true;
  return next < list.size() && has_machine(list.substr(next + 1), machine);
}

Status check_job_is_here() {
  const std::string nodes = variable("SLURM_JOB_NODELIST");
  const std::string machine = host_name();
  if (variable("SLURM_JOB_ID").empty() || nodes.empty() || has_machine(nodes, machine) ||
      has_machine(nodes, machine.substr(0, machine.find('.'))) || has_machine(nodes, variable("SLURMD_NODENAME")))
    return {};
  return {
      Code::invalid_argument,
      fmt::format("SLURM_JOB_ID names job {}, which is on {}, and this machine is {}", variable("SLURM_JOB_ID"), nodes,
                  machine),
      "run this in the job (a batch script, or srun --pty bash); if there is no such job any more, unset SLURM_JOB_ID"};
}

Hosts hosts_of_job() {
  Hosts hosts;
  if (!variable("SLURM_JOB_ID").empty()) {
    std::tie(hosts.job_machines, hosts.job_tasks) = machines_and_tasks(variable("SLURM_TASKS_PER_NODE"));
    // Where a job on one machine doesn't say how many tasks it has, Slurm counts its cores' worth, or one.
    if (hosts.job_machines == 1 && variable("SLURM_NTASKS").empty()) hosts.job_tasks = 0;
    return hosts;
  }
  const std::string file = variable("PBS_NODEFILE");
  if (file.empty()) return hosts;
  std::set<std::string> machines;
  std::ifstream in(file);
  for (std::string machine; std::getline(in, machine);) {
    if (machine.empty()) continue;
    machines.insert(machine);
    ++hosts.job_tasks;
  }
  hosts.job_machines = static_cast<int>(machines.size());
  if (hosts.job_machines > 1) hosts.file = file;
  // PBS counts one for a job that doesn't say how many processes it has (mpiprocs).
  if (hosts.job_machines == 1 && hosts.job_tasks == 1) hosts.job_tasks = 0;
  return hosts;
}

Result<int> Hosts::slots() const {
  // Open MPI takes nothing else; an address would be of one machine alone.
  if (interface.find(':') != std::string::npos ||
      (interface.find('/') == std::string::npos && interface.find_first_not_of("0123456789.") == std::string::npos &&
       !interface.empty()))
    return Status(Code::invalid_argument, fmt::format("'{}' is no interface and no IPv4 network", interface),
                  "for example eth0 or 10.0.0.0/8");
  if (job_tasks > 0) return job_tasks;
  std::istringstream lines(list);
  std::ifstream in;
  if (!file.empty()) {
    std::error_code error;
    if (std::filesystem::is_regular_file(file, error)) in.open(file);
    if (!in.is_open()) return Status(Code::not_found, fmt::format("the hostfile {} can't be read", file));
  }
  std::istream& hosts = file.empty() ? static_cast<std::istream&>(lines) : in;
  int sum = 0;
  for (std::string host; std::getline(hosts, host, file.empty() ? ',' : '\n');) {
    host = host.substr(0, host.find('#'));
    if (host.find_first_not_of(" \t\r") == std::string::npos) continue;
    const auto slots = slots_in(host, file.empty() ? ":" : "slots=");
    if (!slots) return slots.status();
    sum += *slots;
  }
  if (sum == 0) return Status(Code::invalid_argument, "no host is named", "for example --hosts a:4,b:4");
  return sum;
}

int default_ranks() {
  cpu_set_t set;
  CPU_ZERO(&set);
  const int cores = sched_getaffinity(0, sizeof set, &set) == 0 ? CPU_COUNT(&set) : 1;
  return std::clamp(cores, 1, kDefaultRanksMax);
}

Result<std::string> find_rcbd() {
  const char* named = std::getenv("RCBD_BIN_DIR");
  if (named != nullptr && *named != '\0') {
    const fs::path path = fs::path(named) / "rcbd";
    if (runnable(path)) return absolute_text(path);
    return Status(Code::not_found, fmt::format("RCBD_BIN_DIR is {}, where there is no program rcbd", named),
                  "set it to the folder of rcbd, or unset it");
  }
  std::error_code error;
  const fs::path self = fs::read_symlink("/proc/self/exe", error);
  if (!error && runnable(self.parent_path() / "rcbd")) return (self.parent_path() / "rcbd").string();
  const std::string found = search(path_variable(), "rcbd");
  if (found.empty())
    return Status(Code::not_found, "rcbd was found neither beside this program nor in PATH",
                  "build it (target rcbd), or set RCBD_BIN_DIR to its folder");
  return found;
}

Result<std::vector<std::string>> mpirun_arguments(const JobSpec& spec) {
  const std::string mpirun = search(path_variable(), "mpirun");
  if (mpirun.empty())
    return Status(Code::not_found, "mpirun is not in PATH", "install Open MPI (Debian: apt install openmpi-bin)");
  std::vector<std::string> arguments{mpirun, "--bind-to", "none", "--oversubscribe"};
  if (geteuid() == 0) arguments.emplace_back("--allow-run-as-root");
  if (spec.hosts.several())
    add_hosts(spec.hosts, arguments);
  else
    // A scheduler's job may have other machines, where mpirun would put ranks too.
    arguments.insert(arguments.end(), {"--mca", "btl", "vader,self", "--mca", "ras", "^slurm,gridengine,tm", "--mca",
                                       "plm", "^slurm,tm"});
  // Shared memory of System V ends with the last process that has it, however that ends; files would stay where ranks
  // are killed.
  if (!spec.memory_in_folder)
    arguments.insert(arguments.end(), {"--mca", "shmem_sysv_priority", "100"});
  else if (!spec.hosts.several())
    arguments.insert(arguments.end(), {"--mca", "btl_vader_backing_directory", spec.folder});
  // The folder is on this machine alone; where there is no other, TMPDIR names it (job.cpp).
  if (!spec.folder.empty() && spec.hosts.several())
    arguments.insert(arguments.end(), {"--mca", "orte_local_tmpdir_base", spec.folder});
  arguments.insert(arguments.end(), {"-n", std::to_string(spec.ranks)});
  if (!spec.command.empty()) {
    arguments.insert(arguments.end(), spec.command.begin(), spec.command.end());
    return arguments;
  }
  auto rcbd = find_rcbd();
  if (!rcbd) return rcbd.status();
  arguments.push_back(*rcbd);
  if (spec.endpoint.starts_with("unix:"))
    arguments.insert(arguments.end(), {"--socket", spec.endpoint.substr(5)});
  else
    arguments.insert(arguments.end(), {"--listen", spec.endpoint});
  arguments.insert(arguments.end(), {"--data-dir", spec.data_dir});
  if (!spec.hosts.interface.empty()) arguments.insert(arguments.end(), {"--interface", spec.hosts.interface});
  arguments.insert(arguments.end(), spec.service_arguments.begin(), spec.service_arguments.end());
  return arguments;
}

}  // namespace rcb::launch
