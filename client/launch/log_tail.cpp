#include "client/launch/log_tail.hpp"

#include <algorithm>
#include <cstdint>
#include <fstream>
#include <span>
#include <sstream>
#include <string_view>
#include <vector>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace rcb::launch {
namespace {

constexpr std::uint64_t kReadBytesMax = 64 * 1024;
constexpr std::size_t kLinesMax = 5;
constexpr std::size_t kMpirunLinesMax = 8;

// mpirun frames its own messages with lines of dashes.
bool is_rule(std::string_view line) {
  return line.size() >= 20 && std::all_of(line.begin(), line.end(), [](char c) { return c == '-'; });
}

// What Open MPI says outside of frames after it has said in one what is wrong, on which machine.
bool is_sequel(std::string_view line) {
  if (line.ends_with("failed to start") || line.starts_with("***")) return true;
  if (!line.starts_with('[')) return false;
  for (const std::string_view words : {"] *** ", "] Set MCA parameter", "ORTE_ERROR_LOG", "sent help message"})
    if (line.find(words) != std::string_view::npos) return true;
  return false;
}

}  // namespace

std::string telling_lines(const std::string& text) {
  std::istringstream in(text);
  std::vector<std::string> own;
  std::vector<std::string> of_mpirun;  // its first message: later ones tell what came of it
  std::vector<std::string> sequels;    // told where mpirun has ended before it wrote that message
  int rules = 0;
  for (std::string line; std::getline(in, line);) {
    if (line.ends_with('\r')) line.pop_back();
    if (is_rule(line)) {
      ++rules;
      continue;
    }
    const bool in_frame = rules % 2 == 1;
    if (in_frame && rules > 1) continue;
    std::vector<std::string>& lines = in_frame ? of_mpirun : is_sequel(line) ? sequels : own;
    // All ranks tend to write the same line.
    if (line.find_first_not_of(" \t") != std::string::npos &&
        std::find(lines.begin(), lines.end(), line) == lines.end())
      lines.push_back(line);
  }
  of_mpirun.resize(std::min(of_mpirun.size(), kMpirunLinesMax));
  if (own.empty() && of_mpirun.empty()) own = std::move(sequels);
  const auto told = own.empty() ? std::span(of_mpirun) : std::span(own).last(std::min(own.size(), kLinesMax));
  return fmt::format("{}", fmt::join(told, "\n"));
}

std::string log_tail(const std::string& path) {
  std::ifstream in(path, std::ios::binary | std::ios::ate);
  if (!in) return {};
  const auto bytes = static_cast<std::uint64_t>(in.tellg());
  in.seekg(static_cast<std::streamoff>(bytes - std::min(bytes, kReadBytesMax)));
  std::ostringstream text;
  text << in.rdbuf();
  return telling_lines(text.str());
}

}  // namespace rcb::launch
