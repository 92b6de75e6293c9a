#include "tests/bench/dynamic/slope.hpp"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>

#include <fcntl.h>
#include <fmt/format.h>

#include "client/launch/launch.hpp"
#include "client/solvers/drive.hpp"
#include "client/solvers/mpm/mpm.hpp"
#include "common/cuts/method.hpp"
#include "common/files/descriptor.hpp"
#include "common/io/points.hpp"
#include "tests/bench/driver.hpp"
#include "tests/bench/measure.hpp"
#include "tests/bench/options.hpp"
#include "tests/bench/report.hpp"

namespace rcb::bench {
namespace {

constexpr double kRunSeconds = 3600;  // that one run may take
constexpr const char* kTimes[] = {"wall", "service", "slowest", "mean"};

struct SlopeSetting {
  std::string method;
  std::string tolerance;
};

// METHOD:TOLERANCE; both empty if it is none.
SlopeSetting setting_of(const std::string& text) {
  const std::size_t colon = std::min(text.find(':'), text.size());
  const SlopeSetting setting{text.substr(0, colon), text.substr(std::min(colon + 1, text.size()))};
  const auto method = cuts::method_from_name(setting.method);
  const auto tolerance = solvers::parse_number(setting.tolerance);
  return method && method <= cuts::Method::bands_z && tolerance && *tolerance >= 0 ? setting : SlopeSetting{};
}

// A setting on a number of processes, and the documents of its runs.
struct SlopeRuns {
  int processes;
  SlopeSetting setting;
  Json checked;            // of the untimed run
  std::vector<Json> runs;  // timed
  double apart = 0;        // m, of positions from those of the first run
};

struct Place {
  std::string folder;
  std::string endpoint;
};

// Runs slope_mpi. Its document is one line of what it and mpirun print.
Result<Json> run_once(const SlopeBenchOptions& options, const Place& place, const SlopeRuns& one,
                      const std::vector<std::string>& more) {
  std::error_code ignored;
  const auto self = std::filesystem::read_symlink("/proc/self/exe", ignored);
  const std::string said = place.folder + "/said";
  std::vector<std::string> command{(self.parent_path() / "slope_mpi").string(),
                                   "--json",
                                   "--endpoint=" + place.endpoint,
                                   fmt::format("--points={:.0f}", options.points),
                                   fmt::format("--steps={}", options.steps),
                                   fmt::format("--parts={}", one.processes),
                                   "--method=" + one.setting.method,
                                   "--tolerance=" + one.setting.tolerance};
  command.insert(command.end(), more.begin(), more.end());
  const Descriptor output(open(said.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_APPEND | O_CLOEXEC, 0600));
  if (!output.open()) return Status(Code::io_error, said + " can't be written");
  const Status status = run_command(place.folder, command, one.processes, said, kRunSeconds, output.get());
  Json document;
  std::ifstream in(said);
  for (std::string line; std::getline(in, line);) {
    if (!status.ok()) fmt::print(stderr, "{}\n", line);
    if (Json read = Json::parse(line, nullptr, false); read.is_object()) document = std::move(read);
  }
  if (!status.ok()) return status;
  if (!document.is_object()) return Status(Code::internal, "slope_mpi printed no document");
  return document;
}

// The largest distance along an axis, over all steps, between the positions of two trajectories.
Result<double> largest_distance(const std::string& path, const std::string& other) {
  auto first = io::open_trajectory(path, {});
  if (!first) return first.status();
  auto second = io::open_trajectory(other, {});
  if (!second) return second.status();
  double largest = 0;
  for (;;) {
    const auto one = (*first)->next();
    if (!one) return one.status();
    const auto two = (*second)->next();
    if (!two) return two.status();
    if (!*one || !*two) return largest;
    for (std::size_t a = 0; a < 3; ++a)
      for (std::size_t p = 0; p < (*one)->position[a].size(); ++p)
        largest = std::max(largest, std::abs((*one)->position[a][p] - (*two)->position[a][p]));
  }
}

// The untimed run: does each process hold what it should, and are positions where the first run has them?
Status run_checked(const SlopeBenchOptions& options, const Place& place, SlopeRuns& one) {
  const std::string first = place.folder + "/first.npy";
  const bool is_first = !std::filesystem::exists(first);
  const std::string path = is_first ? first : place.folder + "/other.npy";
  auto run = run_once(options, place, one, {"--positions=every-step", "--check", "--trajectory=" + path});
  if (!run) return run.status();
  one.checked = std::move(*run);
  if (is_first) return {};
  const auto distance = largest_distance(first, path);
  if (!distance) return distance.status();
  one.apart = *distance;
  if (one.apart <= kSameMetres) return {};
  return {Code::internal, fmt::format("positions are up to {} m from those of the first run", one.apart)};
}

// What must be the same in every run of a setting, also when the positions travel at other steps.
Json of_every_run(Json run) {
  for (const char* name : kTimes) run["by_step"].erase(name);
  for (const char* name : {"reports", "positions", "checked"}) run.erase(name);
  return run;
}

Status run_timed(const SlopeBenchOptions& options, const Place& place, SlopeRuns& one) {
  auto run = run_once(options, place, one, {"--positions=" + options.positions});
  if (!run) return run.status();
  one.runs.push_back(std::move(*run));
  if (of_every_run(one.runs.back()) == of_every_run(one.checked)) return {};
  return {Code::internal, "a run differs from the checked one in more than times"};
}

// Over the steps but the first, of each the median of the runs.
double total(const std::vector<Json>& runs, const char* name) {
  double sum = 0;
  for (std::size_t step = 1; step < runs[0]["by_step"][name].size(); ++step) {
    std::vector<double> values;
    for (const Json& run : runs) values.push_back(run["by_step"][name][step].get<double>());
    sum += median(std::move(values));
  }
  return sum;
}

Json row_of(const SlopeBenchOptions& options, const SlopeRuns& one) {
  const Json& run = one.runs[0];
  std::vector<double> walls;
  for (const Json& each : one.runs) walls.push_back(total({each}, "wall"));
  const auto [least, most] = std::minmax_element(walls.begin(), walls.end());
  return {{"scene", "slope"},
          {"n", run["points"]},
          {"dims", 3},
          {"parts", one.processes},
          {"ranks", options.ranks},
          {"tool", "rcbd"},
          {"method", one.setting.method},
          {"work", "slope_mpi"},
          {"cut_tolerance", 0.0},
          {"tolerance", run["tolerance"]},
          {"positions", options.positions},
          {"processes", one.processes},
          {"steps", options.steps},
          {"substeps", run["substeps"]},
          {"seconds", total(one.runs, "wall")},
          {"seconds_min", *least},
          {"seconds_max", *most},
          {"seconds_slowest", total(one.runs, "slowest")},
          {"seconds_mean", total(one.runs, "mean")},
          {"seconds_service", total(one.runs, "service")},
          {"shared_nodes", total(one.runs, "shared_nodes") / run["substeps"].get<double>()},
          {"grid_bytes", total(one.runs, "grid_bytes")},
          {"point_bytes", total(one.runs, "handed_over") * sizeof(solvers::PointState)},
          {"repartitions", run["repartitions"].get<int>() - 1},
          {"error_max", run["error_max"]},
          {"metres_apart", one.apart},
          {"ratio", Json::object()}};
}

std::string slope_table(const Json& rows) {
  std::string text =
      "| processes | method | tolerance | wall s | slowest s | mean s | shared nodes | grid MB | points MB | service | "
      "repartitions | largest error |\n"
      "| ---: | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |\n";
  double apart = 0;
  for (const Json& row : rows) {
    const auto number = [&row](const char* name) { return row[name].get<double>(); };
    text += fmt::format(
        "| {} | {} | {} | {:.2f} | {:.3f} | {:.3f} | {:.0f} | {:.1f} | {:.2f} | {:.1f} % | {} | {:.3g} |\n",
        row["processes"].get<int>(), row["method"].get<std::string>(),
        row["tolerance"].is_string() ? "inf" : fmt::format("{:g}", number("tolerance")), number("seconds"),
        number("seconds_slowest"), number("seconds_mean"), number("shared_nodes"), 1e-6 * number("grid_bytes"),
        1e-6 * number("point_bytes"), 100 * number("seconds_service") / number("seconds"),
        row["repartitions"].get<int>(), number("error_max"));
    apart = std::max(apart, number("metres_apart"));
  }
  return text +
         fmt::format("slowest, mean: processor time of computing; positions at all steps within {:.1e} m in all runs\n",
                     apart);
}

// All settings in turn, each repeat beginning with another one.
Status measure_processes(const SlopeBenchOptions& options, const Place& place, std::vector<SlopeRuns>& settings) {
  for (int turn = 0; turn <= options.repeats; ++turn)
    for (std::size_t k = 0; k < settings.size(); ++k) {
      SlopeRuns& one = settings[(k + static_cast<std::size_t>(turn)) % settings.size()];
      fmt::print(stderr, "{} processes, {} at {}, {}\n", one.processes, one.setting.method, one.setting.tolerance,
                 turn == 0 ? "untimed" : fmt::format("repeat {}", turn));
      const Status status = turn == 0 ? run_checked(options, place, one) : run_timed(options, place, one);
      if (!status.ok()) return status;
    }
  return {};
}

Status measure_all(const SlopeBenchOptions& options, Json& rows) {
  const TemporaryFolder folder;
  if (folder.path().empty()) return {Code::io_error, "no temporary folder can be made", "see TMPDIR"};
  prepare_jobs();
  auto service = launch::Embedded::start(options.ranks, [](double) {});
  if (!service) return service.status();
  for (const int processes : options.processes) {
    std::vector<SlopeRuns> settings;
    for (const std::string& text : options.settings) settings.push_back({processes, setting_of(text), {}, {}});
    const Status status = measure_processes(options, {folder.path(), service->endpoint()}, settings);
    if (!status.ok()) return service->explain(status);
    for (const SlopeRuns& one : settings) rows.push_back(row_of(options, one));
  }
  return {};
}

Status check(const SlopeBenchOptions& options) {
  OptionCheck check("rcb_bench slope");
  check.between("--processes", options.processes, 1, kRanksMax);
  check.between("--ranks", std::vector{options.ranks}, 1, kRanksMax);
  check.whole("--points", {options.points}, 1, 1e8);
  check.between("--steps", std::vector{options.steps}, 1, 1'000'000);
  check.between("--repeats", std::vector{options.repeats}, 1, kRepeatsMax);
  check.known("--positions", {options.positions},
              [](const std::string& word) { return word == "when-needed" || word == "every-step"; });
  for (const std::string& text : options.settings)
    check.holds(!setting_of(text).method.empty(), fmt::format("--settings {}: give METHOD:TOLERANCE", text));
  return check.status();
}

}  // namespace

CLI::App* add_slope(CLI::App& app, SlopeBenchOptions& options) {
  auto* command = app.add_subcommand("slope", "what repartitions give to slope_mpi, the slope on several processes");
  add_list(*command, "--processes", options.processes, "numbers of processes, each with one part");
  add_list(*command, "--settings", options.settings,
           "METHOD:TOLERANCE each; methods: rcb, bands-x, bands-y, bands-z; tolerance inf: the first cuts are kept");
  command->add_option("--positions", options.positions, "when they travel: when-needed, every-step")
      ->capture_default_str();
  command->add_option("--ranks", options.ranks, "MPI ranks of the service")->capture_default_str();
  command->add_option("--points", options.points, "material points")->capture_default_str();
  command->add_option("--steps", options.steps, "of 0.3 s")->capture_default_str();
  command->add_option("--repeats", options.repeats, "timed runs of each setting")->capture_default_str();
  command->add_option("--json", options.json, "write the result to this file");
  return command;
}

Status run_slope(const SlopeBenchOptions& options, Json document) {
  if (Status status = check(options); !status.ok()) return status;
  document["rows"] = Json::array();
  const Status measured = measure_all(options, document["rows"]);
  print(slope_table(document["rows"]));
  if (Status status = write_result(options.json, document); !status.ok()) return status;
  return measured;
}

}  // namespace rcb::bench
