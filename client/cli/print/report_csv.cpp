#include "client/cli/print/report_csv.hpp"

#include <initializer_list>

#include <fmt/format.h>

namespace rcb::cli {
namespace {

using Json = nlohmann::ordered_json;

constexpr std::initializer_list<const char*> kColumns = {
    "scene",         "step",    "epoch",        "n",       "error_before", "error",    "imbalance",
    "repartitioned", "reason",  "axes_flipped", "drifted", "moved",        "migrated", "inserted",
    "removed",       "scanned", "searched",     "rounds",  "reductions",   "skipped",  "bytes"};
// After the seconds: these fields were added last, and columns keep their places.
constexpr std::initializer_list<const char*> kLastColumns = {"parts",          "way",      "weights_as_zero", "sent",
                                                             "positions_step", "strangers"};
constexpr std::initializer_list<const char*> kPhases = {"receive", "exchange", "search", "migrate", "total"};

std::string csv_quoted(const std::string& text) {
  if (text.find_first_of(",\"\n\r") == std::string::npos) return text;
  std::string out = "\"";
  for (const char c : text) out += c == '"' ? std::string("\"\"") : std::string(1, c);
  return out + "\"";
}

// Numbers as in the JSON, so that no digit is lost; null as an empty cell; lists separated by semicolons.
std::string cell(const Json& report, const char* field) {
  const auto found = report.find(field);
  if (found == report.end() || found->is_null()) return {};
  if (found->is_string()) return csv_quoted(found->get<std::string>());
  if (!found->is_array()) return found->dump();
  std::string text;
  for (const Json& item : *found) text += (text.empty() ? "" : ";") + item.get<std::string>();
  return csv_quoted(text);
}

}  // namespace

std::string reports_csv_header() {
  std::string text;
  for (const char* column : kColumns) text += (text.empty() ? "" : ",") + std::string(column);
  for (const char* name : kPhases) text += fmt::format(",seconds_{}", name);
  for (const char* column : kLastColumns) text += fmt::format(",{}", column);
  return text + '\n';
}

std::string report_csv_line(const Json& report) {
  std::string line;
  for (const char* column : kColumns) line += (column == *kColumns.begin() ? "" : ",") + cell(report, column);
  const Json seconds = report.value("seconds", Json::object());
  for (const char* name : kPhases) line += "," + cell(seconds, name);
  for (const char* column : kLastColumns) line += "," + cell(report, column);
  return line + '\n';
}

}  // namespace rcb::cli
