// ServiceLog: the log file of a service, written by its supervisor from the pipe that mpirun writes into.
//
// Invariants
// 1. The file is a regular one of this user (own_files.hpp); what somebody else has put at its path is refused.
// 2. It is never much larger than bytes_max: then it is renamed to PATH.1, whose earlier content goes.
// 3. A file that can't be written, or is removed, ends nothing: bytes are counted as lost, and told once it works
// again.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "common/base/status.hpp"

namespace rcb::launch {

class ServiceLog {
 public:
  static constexpr std::uint64_t kBytesMax = 16 << 20;

  explicit ServiceLog(std::string path, std::uint64_t bytes_max = kBytesMax);
  ~ServiceLog();
  ServiceLog(const ServiceLog&) = delete;
  ServiceLog& operator=(const ServiceLog&) = delete;

  // Errors: io_error, not_authorised.
  Status open();
  const std::string& path() const { return path_; }
  // What the job says.
  void add(std::string_view bytes);
  // A line of the supervisor's own.
  void note(std::string_view text);
  // A job begins: what tail() is about is what it says from here on.
  void begin_job() { recent_.clear(); }
  // The last telling lines of the job, whether or not they could be written.
  std::string tail() const;
  // Makes the file again where somebody has removed or renamed it. Errors: those of open().
  Status refresh();

 private:
  void append(std::string_view bytes);
  void write(std::string_view bytes);
  void rotate();
  bool in_place() const;

  std::string path_;
  std::uint64_t bytes_max_;
  int file_ = -1;
  std::uint64_t bytes_ = 0;
  std::uint64_t lost_bytes_ = 0;
  std::string lost_reason_;
  bool line_open_ = false;  // the last byte was no newline
  std::string recent_;
};

}  // namespace rcb::launch
