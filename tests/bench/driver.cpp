#include "tests/bench/driver.hpp"

#include <atomic>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>

#include <fmt/format.h>
#include <sys/prctl.h>
#include <sys/utsname.h>
#include <unistd.h>

#include "client/launch/job/job.hpp"
#include "common/base/clock.hpp"
#include "tests/bench/json.hpp"
#include "tests/bench/measure.hpp"
#include "tests/bench/rows.hpp"
#include "tests/bench/scenes.hpp"
#include "tests/bench/worker.hpp"

namespace rcb::bench {
namespace {

namespace fs = std::filesystem;
constexpr unsigned kPollMicroseconds = 20'000;

std::atomic<bool> g_interrupted{false};
void on_signal(int) { g_interrupted = true; }

// Until the job has ended. `rows` grows with every cell that was measured.
Status await(launch::Job& job, const std::string& rows, double stall_seconds) {
  const SteadyClock clock;
  double last_growth = clock.seconds();
  std::uintmax_t size = 0;
  for (;;) {
    if (const auto ending = job.poll()) {
      if (ending->clean) return {};
      return {Code::internal, "the MPI job ended with " + ending->text, "its last words are above"};
    }
    if (g_interrupted) return {Code::aborted, "interrupted"};
    std::error_code error;
    const std::uintmax_t now = fs::file_size(rows, error);
    if (!error && now != size) {
      size = now;
      last_growth = clock.seconds();
    }
    if (clock.seconds() - last_growth > stall_seconds)
      return {Code::deadline_exceeded, fmt::format("the MPI job measured nothing for {} s", stall_seconds),
              "the cell it hung in is named above; leave it out with --scenes, --parts or --methods"};
    usleep(kPollMicroseconds);
  }
}

std::string first_line_with(const char* path, const std::string& key) {
  std::ifstream in(path);
  for (std::string line; std::getline(in, line);)
    if (line.starts_with(key)) {
      const auto value = line.find_first_not_of(" \t", line.find_first_of(":=") + 1);
      return value == std::string::npos ? std::string() : line.substr(value);
    }
  return "unknown";
}

// After a job in which nothing happened any more: whether the rest can be run without the peer whose turn it was.
bool go_on_without(Plan& left, int ranks, Rows& result) {
  const bool hung = result.status.code() == Code::deadline_exceeded;
  const Json last = hung && !result.rows.empty() ? result.rows.back() : Json();
  std::erase_if(result.rows.get_ref<Json::array_t&>(), [](const Json& row) { return row.contains("begun"); });
  if (!last.contains("begun")) return false;
  try {
    const Skip skip = skip_of(last["begun"]);
    const auto cell = std::find(left.cells.begin(), left.cells.end(), skip.cell);
    if (skip.tool == "rcbd" || cell == left.cells.end()) return false;
    const std::string failure = fmt::format("no answer in {} s", kStallSeconds);
    fmt::print(stderr, "ranks {}: {}, {} parts: {} {}: {}\n", ranks, skip.cell.scene, skip.cell.parts, skip.tool,
               skip.method, failure);
    Measurement unmeasured;
    unmeasured.setting = {skip.tool, skip.method, kPartition, 0};
    unmeasured.failure = failure;
    const SceneKind* const kind = find_scene_kind(skip.cell.scene);
    for (auto& row : make_rows_json(skip.cell, kind == nullptr ? 3 : kind->dims, ranks, {unmeasured}))
      result.rows.push_back(std::move(row));
    left.cells.erase(left.cells.begin(), cell);
    left.skips.push_back(skip);
    return true;
  } catch (const nlohmann::json::exception&) {
    return false;
  }
}

}  // namespace

TemporaryFolder::TemporaryFolder() {
  std::error_code error;
  std::string name = (fs::temp_directory_path(error) / "rcb_bench.XXXXXX").string();
  if (!error && mkdtemp(name.data()) != nullptr) path_ = name;
}

TemporaryFolder::~TemporaryFolder() {
  std::error_code ignored;
  if (!path_.empty()) fs::remove_all(path_, ignored);
}

Status run_command(const std::string& folder, std::vector<std::string> command, int ranks, const std::string& growing,
                   double stall_seconds, int output) {
  launch::JobSpec spec;
  spec.ranks = ranks;
  spec.command = std::move(command);
  launch::Job job(spec, folder, output);
  const Status status = job.start(false);
  return status.ok() ? await(job, growing, stall_seconds) : status;
}

Status run_job(const std::string& folder, const char* word, int ranks, double stall_seconds, Json& rows) {
  const std::string rows_path = folder + "/rows";
  std::error_code ignored;
  fs::remove(rows_path, ignored);
  const std::string self = fs::read_symlink("/proc/self/exe", ignored).string();
  const Status status =
      run_command(folder, {self, word, folder + "/plan", rows_path}, ranks, rows_path, stall_seconds, STDERR_FILENO);
  std::ifstream in(rows_path);
  for (std::string line; std::getline(in, line);) {
    Json row = Json::parse(line, nullptr, false);
    if (!row.is_discarded()) rows.push_back(std::move(row));  // a killed job's last line may be half a one
  }
  return status;
}

void prepare_jobs() {
  prctl(PR_SET_CHILD_SUBREAPER, 1);  // ranks whose mpirun was killed are found and ended
  struct sigaction action {};
  action.sa_handler = on_signal;
  action.sa_flags = SA_RESTART;
  for (const int number : {SIGINT, SIGTERM, SIGHUP}) sigaction(number, &action, nullptr);
  setenv("OMP_NUM_THREADS", "1", 1);  // the ranks are the parallelism, for everyone
}

bool interrupted() { return g_interrupted; }

Rows run_jobs(const Plan& plan, const std::vector<int>& ranks) {
  Rows result;
  const TemporaryFolder folder;
  if (folder.path().empty()) {
    result.status = {Code::io_error, "no temporary folder can be made", "see TMPDIR"};
    return result;
  }
  prepare_jobs();
  for (const int r : ranks) {
    Plan left = plan;
    do {
      result.status = save(left, folder.path() + "/plan");
      if (result.status.ok()) result.status = run_job(folder.path(), kWorkerWord, r, kStallSeconds, result.rows);
    } while (go_on_without(left, r, result));
    if (!result.status.ok()) break;
  }
  return result;
}

Json describe_machine() {
  double load[1] = {-1};
  utsname system{};
  uname(&system);
  std::string name = first_line_with("/etc/os-release", "PRETTY_NAME=");
  std::erase(name, '"');
  Json machine{{"cpu", first_line_with("/proc/cpuinfo", "model name")},
               {"cores", sysconf(_SC_NPROCESSORS_ONLN)},
               {"memory_gib",
                static_cast<double>(sysconf(_SC_PHYS_PAGES)) * static_cast<double>(sysconf(_SC_PAGE_SIZE)) / 0x1p30},
               {"system", name},
               {"kernel", system.release},
               {"compiler", RCB_COMPILER}};
  machine["load_before"] = getloadavg(load, 1) == 1 ? Json(load[0]) : Json();
  return machine;
}

std::string describe_peers() {
  std::string names;
#ifdef RCB_BENCH_ZOLTAN
  names += "Zoltan RCB, RIB, HSFC";
#else
  names += "no Zoltan";
#endif
#ifdef RCB_BENCH_ZOLTAN2
  names += ", Zoltan2 MJ";
#else
  names += ", no Zoltan2";
#endif
  return names;
}

}  // namespace rcb::bench
