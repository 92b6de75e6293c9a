#include "server/net/files/log_sink.hpp"

#include <chrono>
#include <climits>

#include <fmt/format.h>
#include <poll.h>
#include <unistd.h>

#include "common/base/text.hpp"

namespace rcb::net {
namespace {

constexpr std::size_t kKindsMax = 64;
constexpr std::string_view kCut = " ...\n";

double seconds_of(spdlog::log_clock::time_point time) {
  return std::chrono::duration<double>(time.time_since_epoch()).count();
}

}  // namespace

std::string RepeatLimit::kind_of(std::string_view level, std::string_view line) {
  std::string kind(level);
  int words = 0;
  for (const char c : line) {
    if (c == '\'' || c == '"') break;
    if (c == ' ' && ++words == 2) break;
    if (c < '0' || c > '9') kind += c;
  }
  return kind;
}

bool RepeatLimit::count(Kind& kind, std::uint64_t most, std::string_view line, double seconds) {
  if (kind.lines == 0) kind.since = seconds;
  if (++kind.lines <= most) return true;
  ++kind.held;
  kind.last = line;
  return false;
}

bool RepeatLimit::admit(std::string_view level, std::string_view line, double seconds) {
  // Only clients' texts can make more kinds than kKindsMax; lines of further kinds have only the limit of all lines.
  const std::string name = kind_of(level, line);
  if ((kinds_.contains(name) || kinds_.size() < kKindsMax) && !count(kinds_[name], kAlikeMax, line, seconds))
    return false;
  return count(all_, kAllMax, line, seconds);
}

std::vector<std::string> RepeatLimit::held_back(double seconds) {
  std::vector<std::string> lines;
  const auto over = [&](const Kind& kind) { return seconds - kind.since >= kPeriodSeconds || seconds < kind.since; };
  const auto tell = [&](const Kind& kind, const char* alike) {
    if (kind.held > 0)
      lines.push_back(fmt::format("and {} more{} in the last {:.0f} s, at last: {}", kind.held, alike,
                                  seconds - kind.since, kind.last));
  };
  for (auto kind = kinds_.begin(); kind != kinds_.end();) {
    if (!over(kind->second)) {
      ++kind;
      continue;
    }
    tell(kind->second, " like it");
    kind = kinds_.erase(kind);
  }
  if (over(all_)) {
    tell(all_, " lines");
    all_ = {};
  }
  return lines;
}

void LogSink::sink_it_(const spdlog::details::log_msg& message) {
  const std::string text = escape_controls({message.payload.data(), message.payload.size()});
  const double seconds = seconds_of(message.time);
  // Debug output, which somebody asked for, and critical messages always pass.
  const bool limited = message.level >= spdlog::level::info && message.level < spdlog::level::critical;
  for (const std::string& line : limited ? limit_.held_back(seconds) : std::vector<std::string>()) write_own(line);
  const auto level = spdlog::level::to_string_view(message.level);
  if (limited && !limit_.admit({level.data(), level.size()}, text, seconds)) return;
  spdlog::details::log_msg plain = message;
  plain.payload = text;
  spdlog::memory_buf_t line;
  formatter_->format(plain, line);
  write(std::string(line.data(), line.size()));
}

void LogSink::flush_() {
  for (const std::string& line : limit_.held_back(seconds_of(spdlog::log_clock::now()))) write_own(line);
}

// A line of the sink's own, formatted as the others.
void LogSink::write_own(const std::string& text) {
  spdlog::memory_buf_t line;
  formatter_->format({spdlog::log_clock::now(), {}, "rcbd", spdlog::level::info, text}, line);
  write(std::string(line.data(), line.size()));
}

void LogSink::write(std::string line) {
  if (dropped_ > 0) line = fmt::format("({} lines of the log are missing here: nobody read them)\n{}", dropped_, line);
  if (line.size() > PIPE_BUF) line.replace(PIPE_BUF - kCut.size(), std::string::npos, kCut);
  dropped_ = write_now(line) ? 0 : dropped_ + 1;
}

// A pipe that poll() calls writable takes PIPE_BUF bytes without blocking.
bool LogSink::write_now(std::string_view line) const {
  pollfd fd{file_, POLLOUT, 0};
  if (::poll(&fd, 1, 0) <= 0 || (fd.revents & POLLOUT) == 0) return false;
  return ::write(file_, line.data(), line.size()) == static_cast<ssize_t>(line.size());
}

}  // namespace rcb::net
