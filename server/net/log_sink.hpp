// LogSink: a rank's log lines on standard error, which never make it wait and never flood the log.
//
// Invariants
// 1. A line is written only where the pipe has room for it, as poll() says: whoever should read it (mpirun, the
//    supervisor) may be stopped, and the service goes on. Lines for which there was no room are counted, and told
//    later.
// 2. Of lines that are alike, RepeatLimit lets a few pass in a period; the others are counted, and told later.
// 3. What is logged may hold words of clients: no control character of theirs forges a line or drives a terminal.
#pragma once

#include <cstdint>
#include <map>
#include <mutex>
#include <string>
#include <string_view>
#include <vector>

#include <spdlog/sinks/base_sink.h>

namespace rcb::net {

// Lines are alike if they have the same level and begin with the same two words, digits and quoted text left out. Since
// a peer may have its say in a line (a client's name), there is a limit to all lines together, too.
class RepeatLimit {
 public:
  static constexpr double kPeriodSeconds = 30;
  static constexpr std::uint64_t kAlikeMax = 10;
  static constexpr std::uint64_t kAllMax = 200;

  // Whether that line may be written now.
  bool admit(std::string_view level, std::string_view line, double seconds);
  // What was held back in the periods that are over by now, a line each.
  std::vector<std::string> held_back(double seconds);

 private:
  struct Kind {
    double since = 0;
    std::uint64_t lines = 0;
    std::uint64_t held = 0;
    std::string last;  // of those that were held back
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
  void flush_() override;  // tells what was held back
  void write(std::string line);
  bool write_now(std::string_view line) const;
  void write_own(const std::string& text);

  int file_;
  std::uint64_t dropped_ = 0;
  RepeatLimit limit_;
};

}  // namespace rcb::net
