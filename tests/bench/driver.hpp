// The driver: one MPI job a rank count, one after the other, and what they measured put together.
#pragma once

#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "tests/bench/json.hpp"
#include "tests/bench/plan.hpp"

namespace rcb::bench {

struct Rows {
  Json rows = Json::array();
  Status status;  // not ok: a job failed; `rows` has what was measured before
};

// A folder that goes with this object; its path is empty if it could not be made.
class TemporaryFolder {
 public:
  TemporaryFolder();
  ~TemporaryFolder();
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  const std::string& path() const { return path_; }

 private:
  std::string path_;
};

// Before the first run_job: signals end it, and ranks whose mpirun died are found.
void prepare_jobs();
bool interrupted();  // by a signal since then
// One MPI job of a command, whose output goes to the descriptor. It is killed when `growing`, a file, has not grown for
// so long. Errors: as run_jobs().
Status run_command(const std::string& folder, std::vector<std::string> command, int ranks, const std::string& growing,
                   double stall_seconds, int output);
// One MPI job of this program, `word` before its arguments: the plan in `folder`, and the file that it writes rows to,
// which are added to `rows` also where it fails. Errors: as run_jobs().
Status run_job(const std::string& folder, const char* word, int ranks, double stall_seconds, Json& rows);

// Runs `plan` on each number of ranks through mpirun. Waits for a job as long as it goes on; one in which nothing
// happens for kStallSeconds is killed. A peer whose turn it was gets a row that says so, and the rest is run without it
// in that cell. Errors: deadline_exceeded, aborted (SIGINT or SIGTERM), internal, io_error.
inline constexpr double kStallSeconds = 120;
Rows run_jobs(const Plan& plan, const std::vector<int>& ranks);

// CPU, cores, memory, system, MPI, compiler, load before the start.
Json describe_machine();
// The peers that this build has, in words.
std::string describe_peers();

}  // namespace rcb::bench
