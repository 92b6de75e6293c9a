#include "tests/bench/figure.hpp"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <map>
#include <vector>

#include <fcntl.h>
#include <fmt/format.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include "common/base/child.hpp"
#include "tests/bench/json.hpp"
#include "tests/bench/peers/contender.hpp"
#include "tests/bench/report.hpp"

extern char** environ;

namespace rcb::bench {
namespace {

constexpr double kErrorFloor = 1e-8;  // where an error of 0 is drawn on the logarithmic axis
constexpr double kPlotSeconds = 60;
constexpr int kRanksPreferred = 2;
constexpr int kPanelWidth = 380;
constexpr int kKeyWidth = 190;

// Filled shapes are ours, open ones the peers'. Each has a shape of its own, so that they can be told apart without
// colours.
struct Look {
  const char* tool;
  const char* method;
  const char* colour;
  int point;
};
constexpr std::array kLooks{Look{"rcbd", "rcb", "#c1272d", 7},      Look{"rcbd", "bands-x", "#e08214", 9},
                            Look{"rcbd", "bands-y", "#8c6d1f", 11}, Look{"rcbd", "bands-z", "#b8860b", 13},
                            Look{"Zoltan", "RCB", "#1f5f99", 4},    Look{"Zoltan", "RIB", "#3a8f5c", 8},
                            Look{"Zoltan", "HSFC", "#7b5ea7", 12},  Look{"Zoltan2", "MJ", "#444444", 6}};

int ranks_drawn(const Json& rows) {
  int most = 0;
  for (const Json& row : rows) {
    const int ranks = row["ranks"];
    if (ranks == kRanksPreferred) return ranks;
    most = std::max(most, ranks);
  }
  return most;
}

// "milliseconds error" a line. A point with a tolerance is drawn smaller, so that the exact runs stand out.
std::string points_of(const Json& rows, int ranks, int parts, const Look& look) {
  std::string data;
  for (const Json& row : rows) {
    if (row["ranks"] != ranks || row["parts"] != parts || row["work"] != kPartition || !row["seconds"].is_number())
      continue;
    if (row["tool"] != look.tool || row["method"] != look.method) continue;
    const double error = std::max(row["error"].get<double>(), kErrorFloor);
    const double size = row["cut_tolerance"] == 0 ? 0.7 : 0.4;
    data += fmt::format("{} {} {}  # {}, tolerance {}\n", 1e3 * row["seconds"].get<double>(), error, size,
                        row["scene"].get<std::string>(), row["cut_tolerance"].dump());
  }
  return data;
}

// From one power of ten to another; all panels have the same, so that they can be compared.
std::string range_of_milliseconds(const Json& rows, int ranks) {
  double least = 1;
  double most = 1;
  bool any = false;
  for (const Json& row : rows) {
    if (row["ranks"] != ranks || row["work"] != kPartition || !row["seconds"].is_number() || row["tool"] == kFloor)
      continue;
    const double milliseconds = 1e3 * row["seconds"].get<double>();
    least = any ? std::min(least, milliseconds) : milliseconds;
    most = any ? std::max(most, milliseconds) : milliseconds;
    any = true;
  }
  return fmt::format("[1e{:.0f}:1e{:.0f}]", std::floor(std::log10(least)), std::ceil(std::log10(most)));
}

std::string script(const Json& rows, int ranks, const std::vector<int>& parts, const std::string& output) {
  const auto panels = static_cast<double>(std::max<std::size_t>(1, parts.size()));
  const double width = panels * kPanelWidth + kKeyWidth;
  std::string text = figure_head(width, output);
  text += fmt::format(
      "set format x '%g'\n"
      "set format y '%.0e'\n"
      "set yrange [{}:100]\n"
      "set ytics 100 add ('0' {})\n"
      "set xrange {}\n"
      "set xlabel 'milliseconds of one partition'\n",
      kErrorFloor / 3, kErrorFloor, range_of_milliseconds(rows, ranks));
  text += fmt::format(
      "set multiplot layout 1,{} margins {:.3f},{:.3f},0.13,0.84 spacing {:.3f} title "
      "'run time against largest relative error of a part, {} rank(s); a point: one set of points at one tolerance "
      "(small: above 0)'\n",
      parts.size(), 95 / width, panels * kPanelWidth / width, 55 / width, ranks);
  for (std::size_t panel = 0; panel < parts.size(); ++panel) {
    std::string plots;
    for (std::size_t l = 0; l < kLooks.size(); ++l) {
      const std::string data = points_of(rows, ranks, parts[panel], kLooks[l]);
      if (data.empty()) continue;
      const std::string name = fmt::format("$p{}_{}", panel, l);
      text += fmt::format("{} << EOD\n{}EOD\n", name, data);
      plots += fmt::format("{}{} using 1:2:3 with points pointtype {} pointsize variable linecolor '{}' title '{} {}'",
                           plots.empty() ? "plot " : ", ", name, kLooks[l].point, kLooks[l].colour, kLooks[l].tool,
                           kLooks[l].method);
    }
    const bool last = panel + 1 == parts.size();
    text += fmt::format("set title '{} parts'\n", parts[panel]);
    text += panel == 0 ? "set ylabel 'largest abs(load - target) / target'\n" : "unset ylabel\n";
    text += last ? "set key at screen 0.99, screen 0.84 right top\n" : "unset key\n";
    text += plots + "\n";
  }
  return text + "unset multiplot\n";
}

}  // namespace

std::string figure_head(double width, const std::string& output) {
  return fmt::format(
      "set terminal svg size {},520 noenhanced font 'sans-serif,13' background '#ffffff'\n"
      "set output '{}'\n"
      "set border 3 linecolor '#444444'\n"
      "set tics nomirror textcolor '#222222'\n"
      "set grid linecolor '#dddddd' linetype 1 linewidth 0.5\n"
      "set logscale xy\n",
      width, output);
}

Status check_output(const std::string& path) {
  if (path.find_first_of("'\n\\") == std::string::npos) return {};
  return {Code::invalid_argument, path + ": a quote, backslash or line break in the figure's name"};
}

Status plot(const std::string& script, const std::string& output) {
  const std::string script_path = (output.ends_with(".svg") ? output.substr(0, output.size() - 4) : output) + ".gp";
  if (Status status = write_file(script_path, script); !status.ok()) return status;
  std::string program = "gnuplot";
  std::string argument = script_path;
  std::array<char*, 3> argv{program.data(), argument.data(), nullptr};
  pid_t pid = -1;
  const int fault = posix_spawnp(&pid, program.c_str(), nullptr, nullptr, argv.data(), environ);
  if (fault != 0)
    return {Code::not_found, fmt::format("gnuplot can't be started: {}", std::strerror(fault)),
            fmt::format("install it (Debian: apt install gnuplot-nox), then: gnuplot {}", script_path)};
  const auto status = wait_or_kill(pid, kPlotSeconds);
  if (!status) return {Code::deadline_exceeded, fmt::format("gnuplot took more than {} s", kPlotSeconds)};
  if (*status != 0) return {Code::internal, "gnuplot failed on " + script_path};
  return {};
}

Status draw(const Json& document, const std::string& path) {
  if (Status status = check_output(path); !status.ok()) return status;
  const Json& rows = document["rows"];
  const int ranks = ranks_drawn(rows);
  std::vector<int> parts;
  for (const Json& row : rows)
    if (row["ranks"] == ranks && std::find(parts.begin(), parts.end(), row["parts"]) == parts.end())
      parts.push_back(row["parts"]);
  if (parts.empty()) return {Code::invalid_argument, "there is nothing to draw"};
  return plot(script(rows, ranks, parts, path), path);
}

}  // namespace rcb::bench
