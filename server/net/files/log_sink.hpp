// LogSink: writes a rank's log lines to standard error without ever waiting and without flooding the log.
//
// Invariants
// 1. A line is written only if poll() says that the pipe has room: its reader (mpirun, the supervisor) may be stopped,
//    and the service must go on. Lines that found no room are counted and reported later.
// 2. RepeatLimit lets a few similar lines pass in a period; the others are counted and reported later.
// 3. Logged text may come from clients: its control characters are escaped, so that it can't forge a line or drive a
//    terminal.
#pragma once

#include <cstdint>
#include <map>
#include <mutex>
#include <string>
#include <string_view>
#include <vector>

#include <spdlog/sinks/base_sink.h>

namespace rcb::net {

// Lines are alike if they have the same level and the same first two words, without digits and quoted text. Since
// clients can choose some of these words (a client's name), all lines together are limited, too.
class RepeatLimit {
 public:
  static constexpr double kPeriodSeconds = 30;
  static constexpr std::uint64_t kAlikeMax = 10;
  static constexpr std::uint64_t kAllMax = 200;

  // Whether this line may be written at time `seconds`.
  bool admit(std::string_view level, std::string_view line, double seconds);
  // One line for each kind of lines held back in periods that have ended by time `seconds`.
  std::vector<std::string> held_back(double seconds);

 private:
  struct Kind {
    double since = 0;
    std::uint64_t lines = 0;
    std::uint64_t held = 0;
    std::string last;  // the last line that was held back
  };
  static std::string kind_of(std::string_view level, std::string_view line);
  static bool count(Kind& kind, std::uint64_t most, std::string_view line, double seconds);
  std::map<std::string, Kind> kinds_;
  Kind all_;
};

class LogSink final : public spdlog::sinks::base_sink<std::mutex> {
 public:
  explicit LogSink(int file) : file_(file) {}

 private:
  void sink_it_(const spdlog::details::log_msg& message) override;
  void flush_() override;  // reports the lines held back
  void write(std::string line);
  bool write_now(std::string_view line) const;
  void write_own(const std::string& text);

  int file_;
  std::uint64_t dropped_ = 0;
  RepeatLimit limit_;
};

}  // namespace rcb::net
