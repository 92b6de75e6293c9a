// ServiceLog: the log file of a service, written by its supervisor from the pipe into which mpirun writes.
//
// Invariants
// 1. The file is a regular one of this user (own_files.hpp); anything else at its path is refused.
// 2. It never gets much larger than bytes_max: then it is renamed to PATH.1, replacing an older one.
// 3. If the file can't be written, or is removed, the service goes on: lost bytes are counted, and reported in the log
//    once it can be written again.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "common/base/status.hpp"
#include "common/files/descriptor.hpp"

namespace rcb::launch {

class ServiceLog {
 public:
  static constexpr std::uint64_t kBytesMax = 16 << 20;

  explicit ServiceLog(std::string path, std::uint64_t bytes_max = kBytesMax);

  // Errors: io_error, not_authorised.
  Status open();
  const std::string& path() const { return path_; }
  // Adds output of the job.
  void add(std::string_view bytes);
  // Adds a line of the supervisor's own.
  void note(std::string_view text);
  // A job begins: tail() is about its output only.
  void begin_job() { recent_.clear(); }
  // The last informative lines of the job, also if they could not be written.
  std::string tail() const;
  // Creates the file again if somebody has removed or renamed it. Errors: those of open().
  Status refresh();

 private:
  void append(std::string_view bytes);
  void write(std::string_view bytes);
  void rotate();
  bool in_place() const;

  std::string path_;
  std::uint64_t bytes_max_;
  Descriptor file_;
  std::uint64_t bytes_ = 0;
  std::uint64_t lost_bytes_ = 0;
  std::string lost_reason_;
  bool line_open_ = false;  // the last byte was no newline
  std::string recent_;
};

}  // namespace rcb::launch
