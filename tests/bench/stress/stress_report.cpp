#include "tests/bench/stress/stress_report.hpp"

#include <algorithm>
#include <bit>
#include <map>
#include <set>

#include <fmt/format.h>

#include "common/partition/balance/load.hpp"
#include "tests/bench/json.hpp"

namespace rcb::bench {
namespace {

constexpr std::uint64_t kRoundsPerWord = 8;  // a level, for each key word that ties reach

std::string text(const Json& row, const char* field) { return row[field].get<std::string>(); }
bool failed(const Json& row) { return row.contains("failure"); }
bool ours(const Json& row) { return row["tool"] == "rcbd"; }
std::string contender_of(const Json& row) { return text(row, "tool") + " " + text(row, "method"); }

std::string problem_of(const Json& row) {
  return fmt::format("{:<15} {:>8} {:>5}", text(row, "scene"), row["n"].get<std::uint64_t>(), row["parts"].get<int>());
}

// What any exact partition has: the quotas' own error, and their empty parts.
partition::LoadSummary best(const Json& row) {
  return partition::summarise_counts(partition::quotas(row["n"], {}, row["parts"]), {});
}

// The worst over the numbers of ranks, in the columns of one contender.
struct Worst {
  std::string failure;
  double error = 0;
  std::uint64_t empty = 0;
  std::uint64_t differs = 0;
  std::uint64_t rounds = 0;
  bool asked = true;  // for owners
  bool compared = false;
  bool same = true;

  void add(const Json& row) {
    if (failed(row)) {
      failure = text(row, "failure");
      return;
    }
    error = std::max(error, row["error"].get<double>());
    empty = std::max(empty, row["empty_parts"].get<std::uint64_t>());
    asked = asked && !row["owner_differs"].is_null();
    if (asked) differs = std::max(differs, row["owner_differs"].get<std::uint64_t>());
    rounds = std::max(rounds, row.value("rounds", std::uint64_t{0}));
    if (row["same_on_all_ranks"].is_null()) return;
    compared = true;
    same = same && row["same_on_all_ranks"].get<bool>();
  }
  std::string columns() const {
    if (!failure.empty()) return fmt::format("{:<30}", failure.substr(0, 30));
    return fmt::format("{:>9} {:>5} {:>5} {:>8}", error == 0 ? "0" : fmt::format("{:.2e}", error), empty,
                       !compared ? "-"
                       : same    ? "yes"
                                 : "NO",
                       asked ? std::to_string(differs) : "-");
  }
};

}  // namespace

void compare_ranks(Json& rows) {
  std::map<std::string, std::set<std::string>> answers;
  std::map<std::string, int> runs;
  const auto key = [](const Json& row) { return contender_of(row) + problem_of(row); };
  for (const Json& row : rows) {
    if (failed(row)) continue;
    ++runs[key(row)];
    answers[key(row)].insert(text(row, "assignment") + (row.contains("hash") ? text(row, "hash") : ""));
  }
  for (Json& row : rows)
    if (!failed(row)) row["same_on_all_ranks"] = runs[key(row)] < 2 ? Json() : Json(answers[key(row)].size() == 1);
}

std::string stress_table(const Json& document) {
  std::vector<std::string> contenders;
  std::vector<std::string> problems;
  std::map<std::string, std::map<std::string, Worst>> worst;
  const auto note = [](std::vector<std::string>& names, const std::string& name) {
    if (std::find(names.begin(), names.end(), name) == names.end()) names.push_back(name);
  };
  for (const Json& row : document["rows"]) {
    note(contenders, contender_of(row));
    note(problems, problem_of(row));
    worst[problem_of(row)][contender_of(row)].add(row);
  }
  std::string lines = fmt::format("{:30}", "");
  for (const std::string& contender : contenders) lines += fmt::format(" | {:<30}", contender);
  lines += fmt::format("\n{:<15} {:>8} {:>5}", "scene", "points", "parts");
  for (std::size_t c = 0; c < contenders.size(); ++c) lines += "  |     error empty  same   owner!";
  lines += " | our rounds\n";
  for (const std::string& problem : problems) {
    lines += problem;
    std::uint64_t rounds = 0;
    for (const std::string& contender : contenders) {
      const Worst& found = worst[problem][contender];
      lines += "  | " + found.columns();
      rounds = std::max(rounds, found.rounds);
    }
    lines += fmt::format(" | {:>10}\n", rounds);
  }
  return lines +
         "\nerror: largest |load - target| / target. empty: parts without a particle. same: one answer on all numbers "
         "of ranks.\nowner!: particles for which the tool's own question \"who owns this position?\" names another "
         "part "
         "than it gave them.\n";
}

Status stress_verdict(const Json& document) {
  for (const Json& row : document["rows"]) {
    if (!ours(row)) continue;
    const auto wrong = [&](const std::string& what) {
      return Status(Code::internal, fmt::format("{}, {} points, {} parts, {} ranks: {}", text(row, "scene"),
                                                row["n"].dump(), row["parts"].dump(), row["ranks"].dump(), what));
    };
    if (failed(row)) return wrong(text(row, "failure"));
    const partition::LoadSummary quotas = best(row);
    const auto empty = static_cast<std::uint64_t>(std::count(quotas.counts.begin(), quotas.counts.end(), 0U));
    const auto levels = std::bit_width(row["parts"].get<std::uint64_t>() - 1);
    const auto words = row["dims"].get<std::uint64_t>() + 1;
    if (row["error"] != quotas.error) return wrong("error " + row["error"].dump());
    if (row["empty_parts"] != empty) return wrong(row["empty_parts"].dump() + " empty parts");
    if (row["owner_differs"] != 0) return wrong(row["owner_differs"].dump() + " owners differ from the partition");
    if (row["same_on_all_ranks"] == false) return wrong("another answer on another number of ranks");
    if (row["rounds"].get<std::uint64_t>() > kRoundsPerWord * static_cast<std::uint64_t>(levels) * words)
      return wrong(row["rounds"].dump() + " rounds");
  }
  return {};
}

}  // namespace rcb::bench
