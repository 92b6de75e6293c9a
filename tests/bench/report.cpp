#include "tests/bench/report.hpp"

#include <algorithm>
#include <cstdio>
#include <functional>
#include <map>
#include <set>

#include <fmt/format.h>

#include "tests/bench/json.hpp"
#include "tests/bench/measure.hpp"

namespace rcb::bench {
namespace {

using Line = std::vector<std::string>;

}  // namespace

std::string table(const std::vector<Line>& lines, std::size_t left) {
  std::vector<std::size_t> width;
  for (const Line& line : lines)
    for (std::size_t c = 0; c < line.size(); ++c) {
      if (c == width.size()) width.push_back(0);
      width[c] = std::max(width[c], line[c].size());
    }
  std::string text;
  for (const Line& line : lines) {
    for (std::size_t c = 0; c < line.size(); ++c) {
      if (c > 0) text += "  ";
      text += c < left ? fmt::format("{:<{}}", line[c], width[c]) : fmt::format("{:>{}}", line[c], width[c]);
    }
    text.erase(text.find_last_not_of(' ') + 1);
    text += "\n";
  }
  return text;
}

namespace {

std::string name_of(const Json& row) {
  const std::string tool = row["tool"];
  std::string name = (tool == "rcbd" || tool == kFloor ? "" : tool + " ") + row["method"].get<std::string>();
  return row["work"] == kPartitionMigrate ? name + " +migrate" : name;
}

bool ours(const Json& row) { return row["tool"] == "rcbd"; }
bool measured(const Json& row) { return row["seconds"].is_number(); }

// Distinct values of a field, in the order in which they come.
template <typename T>
std::vector<T> values_of(const Json& rows, const char* field) {
  std::vector<T> values;
  for (const Json& row : rows)
    if (std::find(values.begin(), values.end(), row[field].get<T>()) == values.end()) values.push_back(row[field]);
  return values;
}

// The row that stands for a contender in a table: the exact one; of several the fastest.
const Json* representative(const std::vector<const Json*>& rows, const std::string& name) {
  const Json* best = nullptr;
  for (const Json* row : rows) {
    if (name_of(*row) != name || (*row)["cut_tolerance"] != 0) continue;
    if (best == nullptr || !measured(*best) || (measured(*row) && (*row)["seconds"] < (*best)["seconds"])) best = row;
  }
  return best;
}

std::string static_ms(const Json& row) {
  return measured(row) ? fmt::format("{:.1f}", 1e3 * row["seconds"].get<double>()) : "failed";
}

std::string static_error(const Json& row) {
  if (!measured(row)) return "failed";
  if (row["tool"] == kFloor) return "-";
  std::string text = fmt::format("{:.2g}", row["error"].get<double>());
  if (ours(row) || row["empty_parts"] == 0) return text;
  return text + fmt::format(" ({} empty)", row["empty_parts"].get<std::uint64_t>());
}

// Our time as a multiple of the floor; of a peer's, what it takes beside our 1.
std::string ratio_text(const std::string& peer, double ratio) {
  return peer == kRead ? fmt::format("{:.1f}", ratio) : fmt::format("1 : {:.1f}", 1 / ratio);
}

// True if scenes were run with several numbers of points.
bool several_sizes(const Json& rows) {
  std::map<std::string, std::uint64_t> first;
  return std::any_of(rows.begin(), rows.end(), [&](const Json& row) {
    const std::uint64_t n = row["n"];
    return first.emplace(row["scene"], n).first->second != n;
  });
}

// One table a rank count, a line a scene, number of points and number of parts, a column a contender.
std::string wide_table(const Json& rows, int ranks, const std::vector<std::string>& names,
                       const std::function<std::string(const Json&)>& text_of, bool with_ratios) {
  using Key = std::tuple<std::string, std::uint64_t, int>;
  std::map<Key, std::vector<const Json*>> cells;
  std::vector<Key> order;
  std::vector<std::string> peers;
  const bool sizes = several_sizes(rows);
  for (const Json& row : rows) {
    if (row["ranks"] != ranks) continue;
    const Key key{row["scene"], row["n"], row["parts"]};
    if (!cells.contains(key)) order.push_back(key);
    cells[key].push_back(&row);
    for (const auto& [peer, ratio] : row["ratio"].items())
      if (std::find(peers.begin(), peers.end(), peer) == peers.end()) peers.push_back(peer);
  }
  Line head{"scene"};
  if (sizes) head.emplace_back("points");
  head.emplace_back("parts");
  head.insert(head.end(), names.begin(), names.end());
  if (with_ratios)
    for (const std::string& peer : peers) head.push_back(peer == kRead ? "rcb / read" : "rcb : " + peer);
  std::vector<Line> lines{head};
  for (const auto& key : order) {
    Line line{std::get<0>(key)};
    if (sizes) line.push_back(std::to_string(std::get<1>(key)));
    line.push_back(std::to_string(std::get<2>(key)));
    for (const std::string& name : names) {
      const Json* row = representative(cells[key], name);
      line.push_back(row == nullptr ? "-" : text_of(*row));
    }
    const Json* rcb = representative(cells[key], "rcb");
    for (std::size_t p = 0; with_ratios && p < peers.size(); ++p) {
      const bool known = rcb != nullptr && (*rcb)["ratio"].contains(peers[p]);
      line.push_back(known ? ratio_text(peers[p], (*rcb)["ratio"][peers[p]]) : "-");
    }
    lines.push_back(std::move(line));
  }
  return table(lines, 1);
}

// Nanoseconds a point of the exact rcb: a line a scene and number of parts, a column a number of points; then the
// greatest as a multiple of the first.
std::string size_table(const Json& rows, int ranks) {
  const auto sizes = values_of<std::uint64_t>(rows, "n");
  Line head{"scene", "parts"};
  for (const std::uint64_t n : sizes) head.push_back(std::to_string(n));
  head.emplace_back("worst / first");
  std::vector<Line> lines{head};
  for (const std::string& scene : values_of<std::string>(rows, "scene"))
    for (const int parts : values_of<int>(rows, "parts")) {
      Line line{scene, std::to_string(parts)};
      double first = 0;
      double worst = 0;
      for (const std::uint64_t n : sizes) {
        std::vector<const Json*> cell;
        for (const Json& row : rows)
          if (row["ranks"] == ranks && row["scene"] == scene && row["parts"] == parts && row["n"] == n)
            cell.push_back(&row);
        const Json* const rcb = representative(cell, "rcb");
        const bool known = rcb != nullptr && measured(*rcb);
        const double nanoseconds = known ? 1e9 * (*rcb)["seconds"].get<double>() / static_cast<double>(n) : 0;
        line.push_back(known ? fmt::format("{:.1f}", nanoseconds) : "-");
        if (first == 0) first = nanoseconds;
        worst = std::max(worst, nanoseconds);
      }
      line.push_back(first > 0 ? fmt::format("{:.2f}", worst / first) : "-");
      lines.push_back(std::move(line));
    }
  return table(lines, 1);
}

// By method and tolerance over all scenes: the numbers behind the figure.
std::string tolerance_table(const Json& rows, int ranks) {
  std::vector<Line> lines{{"parts", "contender", "tolerance", "median ms", "largest error", "empty parts"}};
  for (const int parts : values_of<int>(rows, "parts")) {
    std::vector<std::pair<std::string, double>> order;
    std::map<std::pair<std::string, double>, std::vector<const Json*>> groups;
    for (const Json& row : rows) {
      if (row["ranks"] != ranks || row["parts"] != parts || row["work"] != kPartition || !measured(row) ||
          row["tool"] == kFloor)
        continue;
      const std::pair<std::string, double> key{name_of(row), row["cut_tolerance"]};
      if (!groups.contains(key)) order.push_back(key);
      groups[key].push_back(&row);
    }
    for (const auto& key : order) {
      std::vector<double> seconds;
      double error = 0;
      std::uint64_t empty = 0;
      for (const Json* row : groups[key]) {
        seconds.push_back((*row)["seconds"]);
        error = std::max(error, (*row)["error"].get<double>());
        empty = std::max(empty, (*row)["empty_parts"].get<std::uint64_t>());
      }
      lines.push_back({std::to_string(parts), key.first, fmt::format("{:g}", key.second),
                       fmt::format("{:.1f}", 1e3 * median(seconds)), fmt::format("{:.2g}", error),
                       std::to_string(empty)});
    }
  }
  return table(lines, 2);
}

// First and last of a group by a field, as seconds per unit: last over first; and the greatest over the first.
Json growth(std::vector<const Json*> rows, const char* field, bool per_particle) {
  std::erase_if(rows, [](const Json* row) { return !measured(*row); });
  if (rows.size() < 2) return nullptr;
  const auto less = [&](const Json* a, const Json* b) { return (*a)[field] < (*b)[field]; };
  const auto [first, last] = std::minmax_element(rows.begin(), rows.end(), less);
  const auto cost = [&](const Json& row) {
    return row["seconds"].get<double>() / (per_particle ? row["n"].get<double>() : 1.0);
  };
  const auto cheaper = [&](const Json* a, const Json* b) { return cost(*a) < cost(*b); };
  const Json* const worst = *std::max_element(rows.begin(), rows.end(), cheaper);
  return {{"from", (**first)[field]},
          {"to", (**last)[field]},
          {"ratio", cost(**last) / cost(**first)},
          {"worst", cost(*worst) / cost(**first)},
          {"worst_at", (*worst)[field]}};
}

}  // namespace

Json summarise_static(const Json& rows) {
  Json summary = Json::array();
  const bool sizes = several_sizes(rows);
  std::map<std::tuple<int, int, std::uint64_t, std::string>, std::vector<std::pair<double, std::string>>> ratios;
  for (const Json& row : rows)
    if (row["method"] == "rcb")
      for (const auto& [peer, ratio] : row["ratio"].items())
        ratios[{row["ranks"], row["parts"], sizes ? row["n"].get<std::uint64_t>() : 0, peer}].emplace_back(
            ratio, row["scene"]);
  for (const auto& [key, list] : ratios) {
    std::vector<double> values;
    for (const auto& entry : list) values.push_back(entry.first);
    const auto worst = *std::max_element(list.begin(), list.end());
    summary.push_back({{"ranks", std::get<0>(key)},
                       {"parts", std::get<1>(key)},
                       {"peer", std::get<3>(key)},
                       {"scenes", list.size()},
                       {"ratio_median", median(values)},
                       {"ratio_worst", worst.first},
                       {"worst_scene", worst.second}});
    if (sizes) summary.back()["n"] = std::get<2>(key);
  }
  return summary;
}

Json summarise_scaling(const Json& rows) {
  Json summary = Json::array();
  std::map<std::tuple<int, std::string, std::string>, std::vector<const Json*>> groups;
  for (const Json& row : rows) groups[{row["ranks"], name_of(row), row["scene"]}].push_back(&row);
  for (const auto& [key, group] : groups) {
    std::vector<const Json*> by_points;
    std::vector<const Json*> by_parts;
    for (const Json* row : group) {
      if ((*row)["parts"] == (*group.front())["parts"]) by_points.push_back(row);
      if ((*row)["n"] == (*group.front())["n"]) by_parts.push_back(row);
    }
    Json most_bytes;
    for (const Json* row : group)
      if (row->contains("bytes_per_particle") && (most_bytes.is_null() || (*row)["bytes_per_particle"] > most_bytes))
        most_bytes = (*row)["bytes_per_particle"];
    summary.push_back({{"ranks", std::get<0>(key)},
                       {"contender", std::get<1>(key)},
                       {"scene", std::get<2>(key)},
                       {"time_per_particle", growth(by_points, "n", true)},
                       {"time_by_parts", growth(by_parts, "parts", false)},
                       {"bytes_per_particle_max", most_bytes}});
  }
  return summary;
}

std::string static_tables(const Json& document) {
  const Json& rows = document["rows"];
  std::vector<std::string> names;
  for (const Json& row : rows)
    if (std::find(names.begin(), names.end(), name_of(row)) == names.end()) names.push_back(name_of(row));
  std::stable_partition(names.begin(), names.end(), [](const auto& name) { return !name.ends_with("+migrate"); });
  std::string text;
  for (const int ranks : values_of<int>(rows, "ranks")) {
    text += fmt::format("\n{} rank(s): milliseconds, median of {}\n\n", ranks, document["repeats"].get<int>());
    text += wide_table(rows, ranks, names, static_ms, true);
    if (several_sizes(rows)) {
      text += fmt::format("\n{} rank(s): nanoseconds a point of rcb, by number of points\n\n", ranks);
      text += size_table(rows, ranks);
    }
    text += fmt::format("\n{} rank(s): largest relative error of a part\n\n", ranks);
    text += wide_table(rows, ranks, names, static_error, false);
    text += fmt::format("\n{} rank(s): by tolerance, over the scenes\n\n", ranks);
    text += tolerance_table(rows, ranks);
  }
  if (document["summary"].empty()) return text;
  std::vector<Line> lines{{"peer", "ranks", "parts", "points", "median", "worst scene", ""}};
  for (const Json& s : document["summary"])
    lines.push_back({s["peer"], s["ranks"].dump(), s["parts"].dump(), s.contains("n") ? s["n"].dump() : "each its own",
                     ratio_text(s["peer"], s["ratio_median"]), ratio_text(s["peer"], s["ratio_worst"]),
                     s["worst_scene"]});
  return text + "\nOur time to the peer's, exact, pairwise in one run, over the scenes\n\n" + table(lines, 1);
}

std::string scaling_tables(const Json& document) {
  std::vector<Line> lines{{"contender", "scene", "ranks", "points", "parts", "ms", "ns/point", "/ read", "reads",
                           "bytes moved", "bytes held", "error"}};
  const auto number = [](const Json& row, const char* field) {
    return row.contains(field) ? fmt::format("{:.1f}", row[field].get<double>()) : std::string("-");
  };
  for (const Json& row : document["rows"]) {
    const double n = row["n"];
    lines.push_back({name_of(row), row["scene"], row["ranks"].dump(), row["n"].dump(), row["parts"].dump(),
                     static_ms(row),
                     measured(row) ? fmt::format("{:.1f}", 1e9 * row["seconds"].get<double>() / n) : "-",
                     number(row["ratio"], kRead), number(row, "reads"), number(row, "bytes_moved"),
                     number(row, "bytes_per_particle"), static_error(row)});
  }
  std::vector<Line> summary{
      {"contender", "scene", "ranks", "time per point", "worst", "points", "time", "parts", "bytes held"}};
  const auto ratio = [](const Json& growth) {
    return growth.is_null() ? std::string("-") : fmt::format("x {:.2f}", growth["ratio"].get<double>());
  };
  const auto range = [](const Json& growth) {
    return growth.is_null() ? std::string("-") : growth["from"].dump() + " to " + growth["to"].dump();
  };
  for (const Json& s : document["summary"])
    summary.push_back(
        {s["contender"], s["scene"], s["ranks"].dump(), ratio(s["time_per_particle"]),
         s["time_per_particle"].is_null() ? "-"
                                          : fmt::format("x {:.2f}", s["time_per_particle"]["worst"].get<double>()),
         range(s["time_per_particle"]), ratio(s["time_by_parts"]), range(s["time_by_parts"]),
         s["bytes_per_particle_max"].is_null() ? "-"
                                               : fmt::format("{:.1f}", s["bytes_per_particle_max"].get<double>())});
  return "\nTime; reads of all positions, and bytes that passes move, a point; memory held at peak beyond the points, "
         "a point\n\n" +
         table(lines, 2) + "\nGrowth from the fewest points to the most, and where it is greatest\n\n" +
         table(summary, 2);
}

void print(const std::string& text) {
  std::fwrite(text.data(), 1, text.size(), stdout);
  std::fflush(stdout);
}

Status write_file(const std::string& path, const std::string& text) {
  const std::string beside = path + ".part";
  std::FILE* file = std::fopen(beside.c_str(), "w");
  bool good = file != nullptr;
  if (good) {
    good = std::fwrite(text.data(), 1, text.size(), file) == text.size();
    good = std::fclose(file) == 0 && good;
  }
  if (good && std::rename(beside.c_str(), path.c_str()) == 0) return {};
  if (file != nullptr) std::remove(beside.c_str());
  return {Code::io_error, path + ": can't be written", "does its folder exist?"};
}

Status write_result(const std::string& path, const Json& document) {
  return path.empty() ? Status() : write_file(path, document.dump(1) + "\n");
}

Status verdict(const Json& document) {
  std::map<std::string, std::string> hashes;
  for (const Json& row : document["rows"]) {
    if (!ours(row)) continue;
    const std::string what =
        fmt::format("{}, {} points, {} parts, {}, tolerance {}", row["scene"].get<std::string>(), row["n"].dump(),
                    row["parts"].dump(), name_of(row), row["cut_tolerance"].dump());
    if (!measured(row)) return {Code::internal, what + ": " + row["failure"].get<std::string>()};
    const auto [at, fresh] = hashes.emplace(what, row["hash"]);
    if (!fresh && at->second != row["hash"])
      return {Code::internal, what + ": another hash on another number of ranks"};
  }
  return {};
}

}  // namespace rcb::bench
