// What the example solvers have in common: command line, connection to the service, step loop, output. A solver gives
// its name, its numeric options and a function that builds its scene.
//
// 1. With --json exactly one JSON document is written to stdout, and nothing else.
// 2. Exit codes are those of rcbctl: 0 done, 1 refused or failed, 2 usage, 3 no service, 4 not authorised, 5 deadline.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "client/solvers/scenes.hpp"
#include "client/solvers/step_loop.hpp"

namespace CLI {
class App;
}

namespace rcb::solvers {

struct RunOptions {
  std::uint64_t points = 0;
  std::int64_t steps = 0;
  int parts = 8;
  double tolerance = 0.1;  // infinity: the first partition is kept
  std::string policy = "tolerance";
  std::string positions = "every-step";
  std::string scene;
  std::string endpoint;          // empty: the client library's default
  std::string trajectory;        // empty: none
  double deadline_seconds = 60;  // for one push
  bool outlive = true;           // go on when the service dies and is restarted
  bool no_service = false;
  bool json = false;
};

struct Program {
  std::string name;
  std::string version;
  std::string description;
  RunOptions defaults;
  std::vector<NumberOption> numbers;
  std::function<Result<Simulation>(std::uint64_t points)> build;
};

// What the JSON document of each solver's finished run says.
nlohmann::json run_json(const std::string& solver, const RunOptions& options, const RunRecord& record);
// The JSON document of a finished run.
std::string json_document(const Program& program, const RunOptions& options, const RunRecord& record);
// The summary of a finished run, for people.
std::string summary(const Program& program, const RunOptions& options, double interval, const RunRecord& record);

// The JSON document of a failed run, as rcbctl writes it.
std::string failure_document(const Status& status);
// Tells a failure on stderr, with json also its document on stdout. Returns the exit code.
int tell_failure(const std::string& program, bool json, const Status& status);

// Whether all that was printed on standard output got there. Errors: io_error.
Status flush_output();

// Prints on stderr what a push waits for, in place of the progress line if there is one.
void say_notice(const std::string& program, const std::string& text);

// "8 parts"; of a scene whose parts another client has changed, how many there are at the end, too.
std::string parts_text(int asked, const std::vector<client::StepReport>& reports);

// Declares the options of RunOptions that each solver has; their defaults are what `options` holds.
void add_run_options(CLI::App& app, RunOptions& options);
void add_numbers(CLI::App& app, const std::vector<NumberOption>& numbers);
bool asks_for_json(int argc, char** argv);

// Reads a number (-.5, 1e3, inf, ...); NaN is refused.
Result<double> parse_number(const std::string& text);
// Reads a whole number in low..high; 1e6 is accepted, too.
Result<std::int64_t> parse_whole(const std::string& text, std::int64_t low, std::int64_t high);

// The main() of a solver. Returns the exit code; no exception escapes.
int run_program(const Program& program, int argc, char** argv);

}  // namespace rcb::solvers
