#include "tests/bench/dynamic/dynamic_report.hpp"

#include <algorithm>
#include <limits>
#include <vector>

#include <fmt/format.h>

#include "tests/bench/figure.hpp"
#include "tests/bench/json.hpp"
#include "tests/bench/report.hpp"

namespace rcb::bench {
namespace {

constexpr double kDynamicFloor = 1e-4;  // where an error of 0 is drawn on the logarithmic axis

std::string setting_of(const Json& row) {
  if (row["policy"] == "cost") return "cost";
  return row["tolerance"].is_string() ? row["tolerance"].get<std::string>()
                                      : fmt::format("{:g}", row["tolerance"].get<double>());
}

bool is_peer(const Json& row) { return row["tool"] != "rcbd"; }

std::string tool_of(const Json& row, const Json& head) {
  std::string name = row["tool"].get<std::string>() + " " + row["method"].get<std::string>();
  if (!is_peer(row)) name += ", " + row["positions"].get<std::string>();
  if (!is_peer(row) && row["axis_hysteresis"] != head["axis_hysteresis"])
    name += fmt::format(", hysteresis {:g}", row["axis_hysteresis"].get<double>());
  return name;
}

std::string milliseconds(const Json& row, const char* field) {
  if (row[field].is_null()) return "-";
  return fmt::format("{:.2f}", 1e3 * row[field].get<double>() / std::max(1.0, row["steps"].get<double>()));
}

std::string error_text(const Json& row, const char* field) { return fmt::format("{:.2g}", row[field].get<double>()); }

std::string title_of(const Json& row) {
  return fmt::format("{}: {} points, {} steps, {} parts, {} rank(s)", row["scene"].get<std::string>(),
                     row["n"].get<std::uint64_t>(), row["steps"].get<int>(), row["parts"].get<int>(),
                     row["ranks"].get<int>());
}

// The rows of one scene, number of parts and of ranks, in the order in which they come.
std::vector<std::vector<const Json*>> groups_of(const Json& rows) {
  std::vector<std::vector<const Json*>> groups;
  for (const Json& row : rows) {
    const auto same = [&row](const auto& group) { return title_of(*group.front()) == title_of(row); };
    const auto found = std::find_if(groups.begin(), groups.end(), same);
    if (found != groups.end())
      found->push_back(&row);
    else
      groups.push_back({&row});
  }
  return groups;
}

double milliseconds_of(const Json& row) {
  return 1e3 * row["seconds_client"].get<double>() / std::max(1.0, row["steps"].get<double>());
}

// A curve of a panel: how gnuplot draws it.
struct CurveLook {
  const char* tool;       // a row's, or null: the policy cost
  const char* positions;  // null: any
  const char* title;
  const char* style;  // linespoints or points
  int point;
  const char* colour;
  const char* labels;  // where they stand; null: none
};
constexpr CurveLook kCurves[] = {{"rcbd", "when-needed", "rcbd, when-needed", "linespoints", 7, "#c1272d", "0.7,0.3"},
                                 {"rcbd", "every-step", "rcbd, every-step", "linespoints", 9, "#e08214", "0.7,0.3"},
                                 {nullptr, nullptr, "rcbd, policy cost", "points", 3, "#c1272d", nullptr},
                                 {"Zoltan", nullptr, "Zoltan RCB", "linespoints", 4, "#1f5f99", "0.7,-0.3"}};

bool shows(const CurveLook& curve, const Json& row) {
  if (curve.tool == nullptr) return row["policy"] == "cost";
  return row["policy"] != "cost" && row["tool"] == curve.tool &&
         (curve.positions == nullptr || row["positions"] == curve.positions);
}

// What gnuplot is told of one scene; its points are added to `data`, in blocks that begin with `name`.
std::string panel_of(const std::vector<const Json*>& group, const std::string& name, std::string& data) {
  const Json& head = *group.front();
  std::string text;
  for (std::size_t c = 0; c < std::size(kCurves); ++c) {
    const CurveLook& curve = kCurves[c];
    std::string points;
    for (const Json* row : group)
      if (shows(curve, *row) && (is_peer(*row) || (*row)["axis_hysteresis"] == head["axis_hysteresis"]))
        points += fmt::format("{} {} {}\n", milliseconds_of(*row),
                              std::max((*row)["error"].get<double>(), kDynamicFloor), setting_of(*row));
    if (points.empty()) continue;
    data += fmt::format("{0}_{1} << EOD\n{2}EOD\n", name, c, points);
    text += fmt::format("{}{}_{} using 1:2 with {} pointtype {} pointsize 0.8 linecolor '{}' title '{}'",
                        text.empty() ? "plot " : ", ", name, c, curve.style, curve.point, curve.colour, curve.title);
    if (curve.labels != nullptr)
      text +=
          fmt::format(", '' using 1:2:3 with labels left offset {} textcolor '{}' notitle", curve.labels, curve.colour);
  }
  return fmt::format("set title '{}'\n{}\n", title_of(head), text);
}

}  // namespace

std::string dynamic_tables(const Json& document) {
  std::string text;
  for (const auto& group : groups_of(document["rows"])) {
    text += "\n" + title_of(*group.front()) + "; milliseconds a step\n";
    std::vector<std::vector<std::string>> lines{
        {"tool", "tolerance", "waited", "bare message", "in service", "balancing", "lost", "both", "repartitions",
         "sent", "drifted", "moved", "migrated", "mean error", "largest", "on arrival", "largest"}};
    for (const Json* row : group) {
      std::vector<std::string> line{tool_of(*row, *group.front()), setting_of(*row)};
      for (const char* field :
           {"seconds_client", "seconds_round_trip", "seconds", "seconds_balancing", "seconds_lost", "seconds_both"})
        line.push_back(milliseconds(*row, field));
      for (const char* field : {"repartitions", "sent", "drifted", "moved", "migrated"})
        line.push_back((*row)[field].is_null() ? "-" : (*row)[field].dump());
      for (const char* field : {"error", "error_max", "error_before_mean", "error_before_max"})
        line.push_back(error_text(*row, field));
      lines.push_back(std::move(line));
    }
    text += table(lines, 2);
  }
  return text;
}

Status draw_dynamic(const Json& document, const std::string& path) {
  if (Status status = check_output(path); !status.ok()) return status;
  const auto groups = groups_of(document["rows"]);
  if (groups.empty()) return {Code::invalid_argument, "there is nothing to draw"};
  std::vector<std::string> panels;
  std::string data;
  double least = std::numeric_limits<double>::max();
  double most = 0;
  for (const auto& group : groups) {
    const Json& head = *group.front();
    if (head["parts"] != groups.front().front()->at("parts") || head["ranks"] != groups.front().front()->at("ranks"))
      continue;
    for (const Json* row : group) {
      least = std::min(least, milliseconds_of(*row));
      most = std::max(most, milliseconds_of(*row));
    }
    panels.push_back(panel_of(group, fmt::format("$p{}", panels.size()), data));
  }
  std::string script = figure_head(static_cast<double>(panels.size()) * 620, path) +
                       fmt::format(
                           "set key outside bottom center horizontal samplen 2\n"
                           "set xrange [{}:{}]\n"
                           "set format xy '%g'\n"
                           "set yrange [{}:10]\n"
                           "set ytics add ('0' {})\n"
                           "set xlabel 'milliseconds that the solver waits a step'\n"
                           "set ylabel 'mean over the steps of the largest relative error of a part'\n",
                           0.7 * least, 2.5 * most, kDynamicFloor / 2, kDynamicFloor);
  script += data + fmt::format("set multiplot layout 1,{}\n", panels.size());
  for (const std::string& panel : panels) script += panel;
  script += "unset multiplot\n";
  return plot(script, path);
}

}  // namespace rcb::bench
