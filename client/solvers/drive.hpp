// What the example solvers have in common: command line, service, step loop, output. A solver names itself, its
// numbers and how its scene is built; the rest happens here.
//
// 1. With --json exactly one JSON document goes to stdout, and nothing else.
// 2. The exit code is that of rcbctl: 0 done, 1 refused or failed, 2 usage, 3 no service, 4 not authorised, 5 deadline.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "client/solvers/scenes.hpp"
#include "client/solvers/step_loop.hpp"

namespace rcb::solvers {

struct RunOptions {
  std::uint64_t points = 0;
  std::int64_t steps = 0;
  int parts = 8;
  double tolerance = 0.1;  // infinity: the first partition stays
  std::string policy = "tolerance";
  std::string scene;
  std::string endpoint;          // empty: as the client library finds it
  std::string trajectory;        // empty: none
  double deadline_seconds = 60;  // of one push
  bool outlive = true;           // a service that dies and comes back
  bool no_service = false;
  bool json = false;
};

// A physical number that the user may change.
struct NumberOption {
  std::string name;  // "--speed"
  std::string help;
  double* value;  // holds the default
};

struct Program {
  std::string name;
  std::string version;
  std::string description;
  RunOptions defaults;
  std::vector<NumberOption> numbers;
  std::function<Result<Simulation>(std::uint64_t points)> build;
};

// The JSON document of a finished run.
std::string json_document(const Program& program, const RunOptions& options, const RunRecord& record);
// The same for people.
std::string summary(const Program& program, const RunOptions& options, double interval, const RunRecord& record);

// And of a failed one, as rcbctl writes it.
std::string failure_document(const Status& status);

// Whether all that was printed on standard output got there. Errors: io_error.
Status flush_output();

// What a push waits for, on standard error; over the progress line, if there is one.
void say_notice(const std::string& program, const std::string& text);

// A number in any of its spellings (-.5, 1e3, inf); not a number is refused.
Result<double> parse_number(const std::string& text);
// A whole number in low..high, 1e6 among its spellings.
Result<std::int64_t> parse_whole(const std::string& text, std::int64_t low, std::int64_t high);

// main() of a solver. Returns the exit code; no exception leaves it.
int run_program(const Program& program, int argc, char** argv);

}  // namespace rcb::solvers
