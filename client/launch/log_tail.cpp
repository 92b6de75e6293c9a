#include "client/launch/log_tail.hpp"

#include <algorithm>
#include <cstdint>
#include <fstream>
#include <sstream>
#include <string_view>
#include <vector>

namespace rcb::launch {
namespace {

constexpr std::uint64_t kReadBytesMax = 64 * 1024;
constexpr std::size_t kLinesMax = 5;

// mpirun frames its own messages with lines of dashes.
bool is_rule(std::string_view line) {
  return line.size() >= 20 && std::all_of(line.begin(), line.end(), [](char c) { return c == '-'; });
}

std::string joined(const std::vector<std::string>& lines) {
  std::string text;
  const std::size_t first = lines.size() > kLinesMax ? lines.size() - kLinesMax : 0;
  for (std::size_t i = first; i < lines.size(); ++i) text += (text.empty() ? "" : "\n") + lines[i];
  return text;
}

}  // namespace

std::string telling_lines(const std::string& text) {
  std::istringstream in(text);
  std::vector<std::string> own;
  std::vector<std::string> of_mpirun;
  bool in_frame = false;
  for (std::string line; std::getline(in, line);) {
    if (is_rule(line)) {
      in_frame = !in_frame;
      continue;
    }
    // mpirun says so after the frame in which it says which program was missing where.
    if (!in_frame && line.ends_with("failed to start")) continue;
    std::vector<std::string>& lines = in_frame ? of_mpirun : own;
    // All ranks tend to write the same line.
    if (line.find_first_not_of(" \t\r") != std::string::npos &&
        std::find(lines.begin(), lines.end(), line) == lines.end())
      lines.push_back(line);
  }
  return joined(own.empty() ? of_mpirun : own);
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
