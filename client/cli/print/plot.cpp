#include "client/cli/print/plot.hpp"

#include <algorithm>
#include <array>
#include <cctype>
#include <cerrno>
#include <cstring>
#include <limits>
#include <numeric>
#include <set>
#include <utility>

#include <fmt/format.h>
#include <signal.h>
#include <spawn.h>
#include <sys/mman.h>
#include <unistd.h>

#include "common/base/child.hpp"
#include "common/files/descriptor.hpp"
#include "common/files/read_write.hpp"
#include "common/io/files/output_file.hpp"

extern char** environ;

namespace rcb::cli {
namespace {

constexpr double kPlotSeconds = 60;
constexpr std::array kColours{"#1f5f99", "#e08214", "#3a8f5c", "#7b5ea7", "#666666"};

// A nameless file in memory, for one of gnuplot's standard streams.
Descriptor memory_file(const char* name) { return Descriptor(memfd_create(name, MFD_CLOEXEC)); }

std::string content(const Descriptor& file) {
  const off_t size = lseek(file.get(), 0, SEEK_END);
  return read_some(file.get(), static_cast<std::size_t>(std::max<off_t>(size, 0)));
}

// Of the lines that aren't empty.
std::string first_line(std::string text) {
  text.erase(0, std::min(text.find_first_not_of(" \n\t"), text.size()));
  return text.substr(0, text.find('\n'));
}

// A curve in words.
std::string title_of(const Curve& curve) {
  if (!curve.tolerance) return curve.name + ": tolerance inf" + (curve.repartitioned() ? "" : ", never repartitioned");
  return fmt::format("{}: tolerance {:g}", curve.name, *curve.tolerance);
}

// The lines, the tolerances and the repartitions of these curves, which have their numbers among all.
std::string plot_of(const std::vector<Curve>& curves, const std::vector<std::size_t>& shown) {
  std::string plots;
  std::set<double> tolerances;
  bool dots = false;
  for (const std::size_t c : shown) {
    // A line of one point would not be seen.
    plots += fmt::format("{}$line{} using 1:2 with {} linecolor '{}' title '{}'", plots.empty() ? "plot " : ", ", c,
                         curves[c].one_step() ? "points pointtype 7" : "lines linewidth 1.8",
                         kColours[c % kColours.size()], title_of(curves[c]));
    if (curves[c].tolerance) tolerances.insert(*curves[c].tolerance);
  }
  for (const double tolerance : tolerances)
    plots += fmt::format(", {} with lines dashtype 2 linewidth 1 linecolor '#888888' title '{}'", tolerance,
                         tolerances.size() == 1 ? "the tolerance" : fmt::format("tolerance {:g}", tolerance));
  for (const std::size_t c : shown)
    if (curves[c].repartitioned())
      plots += fmt::format(", $dots{} using 1:2 with points pointtype 7 pointsize 0.6 linecolor '#d62728' {}", c,
                           std::exchange(dots, true) ? "notitle" : "title 'repartition'");
  return plots + "\n";
}

// Those that are hardly to be seen beside the others.
std::vector<std::size_t> low_curves(const std::vector<Curve>& curves) {
  constexpr double kLow = 0.25;
  double most = 0;
  for (const Curve& curve : curves) most = std::max(most, curve.largest());
  std::vector<std::size_t> low;
  for (std::size_t c = 0; c < curves.size(); ++c)
    if (!curves[c].empty() && !curves[c].one_step() && curves[c].largest() > 0 && curves[c].largest() < kLow * most)
      low.push_back(c);
  return low;
}

// Steps are whole numbers, so no tick stands between two of them; and a single step needs an axis around it.
std::string step_axis(const std::vector<Curve>& curves) {
  constexpr std::int64_t kTicksMax = 10;  // up to so many steps each has one
  std::int64_t first = std::numeric_limits<std::int64_t>::max();
  std::int64_t last = 0;
  for (const Curve& curve : curves) {
    if (curve.empty()) continue;
    first = std::min(first, curve.first_step());
    last = std::max(last, curve.last_step());
  }
  if (first == last) return fmt::format("set xtics ({})\nset xrange [{}:{}]\n", first, first - 1, last + 1);
  return last - first > kTicksMax ? "" : "set xtics 1\n";
}

bool is_png(const std::string& path) {
  constexpr std::string_view kEnding = ".png";
  return path.size() > kEnding.size() &&
         std::ranges::equal(std::string_view(path).substr(path.size() - kEnding.size()), kEnding,
                            [](char a, char b) { return std::tolower(static_cast<unsigned char>(a)) == b; });
}

std::string terminal(const std::string& path, int height) {
  if (is_png(path))
    return fmt::format("set terminal pngcairo size 900,{} noenhanced font 'sans-serif,11' background '#ffffff'\n",
                       height);
  return fmt::format("set terminal svg size 900,{} noenhanced font 'sans-serif,14' background '#ffffff'\n", height);
}

std::string script(const std::string& path, const std::vector<Curve>& curves) {
  const std::vector<std::size_t> low = low_curves(curves);
  std::string text = terminal(path, low.empty() ? 480 : 760) +
                     "set border 3 linecolor '#444444'\n"
                     "set tics out nomirror textcolor '#222222'\n"
                     "set grid ytics linecolor '#dddddd' linetype 1 linewidth 0.5\n"
                     "set key outside top center horizontal reverse Left samplen 2 spacing 1.2\n"
                     "set xlabel 'step'\n"
                     "set ylabel 'largest error of a part'\n"
                     "set yrange [0:*]\n"
                     "set autoscale xfix\n"
                     "set offsets 0, graph 0.01, graph 0.05, 0\n" +
                     step_axis(curves);
  std::vector<std::size_t> all(curves.size());
  std::iota(all.begin(), all.end(), std::size_t{0});
  for (const std::size_t c : all) {
    text += fmt::format("$line{} << EOD\n{}EOD\n", c, curves[c].line_data());
    if (curves[c].repartitioned()) text += fmt::format("$dots{} << EOD\n{}EOD\n", c, curves[c].dot_data());
  }
  if (low.empty()) return text + plot_of(curves, all);
  // Once more by themselves, below, on a scale of their own.
  return text + "set multiplot\nset size 1,0.56\nset origin 0,0.44\n" + plot_of(curves, all) +
         "set size 1,0.44\nset origin 0,0\nset ylabel 'the same, enlarged'\n" + plot_of(curves, low) +
         "unset multiplot\n";
}

// Runs gnuplot and returns the figure.
Result<std::string> run_gnuplot(const std::string& commands) {
  const Descriptor input = memory_file("gnuplot-input");
  const Descriptor output = memory_file("gnuplot-output");
  const Descriptor errors = memory_file("gnuplot-errors");
  if (!input.open() || !output.open() || !errors.open() || !write_all(input.get(), commands) ||
      lseek(input.get(), 0, SEEK_SET) != 0)
    return Status(Code::io_error, fmt::format("no memory file for gnuplot: {}", std::strerror(errno)));
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, input.get(), STDIN_FILENO);
  posix_spawn_file_actions_adddup2(&actions, output.get(), STDOUT_FILENO);
  posix_spawn_file_actions_adddup2(&actions, errors.get(), STDERR_FILENO);
  std::string program = "gnuplot";
  std::array<char*, 2> argv{program.data(), nullptr};
  pid_t pid = -1;
  const int fault = posix_spawnp(&pid, program.c_str(), &actions, nullptr, argv.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  if (fault != 0)
    return Status(Code::not_found, fmt::format("gnuplot can't be started: {}", std::strerror(fault)),
                  "install it (Debian: apt install gnuplot-nox), or plot the table of --csv yourself");
  const auto status = wait_or_kill(pid, kPlotSeconds);
  if (!status) return Status(Code::deadline_exceeded, fmt::format("gnuplot took more than {} s", kPlotSeconds));
  if (*status != 0) return Status(Code::internal, "gnuplot failed: " + first_line(content(errors)));
  return content(output);
}

}  // namespace

Status plot_history(const std::string& path, const std::vector<Curve>& curves) {
  if (std::all_of(curves.begin(), curves.end(), [](const Curve& curve) { return curve.empty(); }))
    return {Code::invalid_argument, "there are no steps to plot yet", "push positions first"};
  const auto figure = run_gnuplot(script(path, curves));
  if (!figure) return figure.status();
  return io::write_file(path, *figure);
}

}  // namespace rcb::cli
