#include "client/cli/report_csv.hpp"

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <initializer_list>

#include <fmt/format.h>
#include <unistd.h>

namespace rcb::cli {
namespace {

using Json = nlohmann::ordered_json;

constexpr std::initializer_list<const char*> kColumns = {
    "scene",   "step",         "epoch",   "n",          "error_before", "error",    "imbalance", "repartitioned",
    "reason",  "axes_flipped", "drifted", "moved",      "migrated",     "inserted", "removed",   "first_id",
    "scanned", "searched",     "rounds",  "reductions", "skipped",      "bytes"};
constexpr std::initializer_list<const char*> kSeconds = {"receive", "exchange", "search", "migrate", "total"};

std::string csv_quoted(const std::string& text) {
  if (text.find_first_of(",\"\n\r") == std::string::npos) return text;
  std::string out = "\"";
  for (const char c : text) out += c == '"' ? std::string("\"\"") : std::string(1, c);
  return out + "\"";
}

// Numbers as they came, so that nothing is lost; null as an empty cell; lists with ; between.
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

Status write_file(const std::string& path, const std::string& text) {
  const std::string beside = fmt::format("{}.{}.part", path, getpid());
  std::FILE* file = std::fopen(beside.c_str(), "wb");
  if (file == nullptr) return {Code::io_error, fmt::format("{}: {}", path, std::strerror(errno))};
  const bool written = std::fwrite(text.data(), 1, text.size(), file) == text.size();
  const int write_errno = errno;
  if (std::fclose(file) == 0 && written && std::rename(beside.c_str(), path.c_str()) == 0) return {};
  const int reason = written ? errno : write_errno;
  std::remove(beside.c_str());
  return {Code::io_error, fmt::format("{}: {}", path, std::strerror(reason))};
}

Status write_reports_csv(const std::string& path, const Json& reports) {
  std::string text;
  for (const char* column : kColumns) text += (text.empty() ? "" : ",") + std::string(column);
  for (const char* name : kSeconds) text += fmt::format(",seconds_{}", name);
  text += '\n';
  for (const Json& report : reports) {
    std::string line;
    for (const char* column : kColumns) line += (column == *kColumns.begin() ? "" : ",") + cell(report, column);
    const Json seconds = report.value("seconds", Json::object());
    for (const char* name : kSeconds) line += "," + cell(seconds, name);
    text += line + "\n";
  }
  return write_file(path, text);
}

}  // namespace rcb::cli
