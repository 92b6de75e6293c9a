// ReportFile: the older reports of one scene, a JSON document a line, appended in their order. It is made at the first
// report, open only while something is read or written, and removed with this.
//
// Invariants
// 1. Of the bytes of the file those that `runs_` tells of are whole lines; the reports between two runs are not in it.
// 2. Whatever happens to the disk or the file is answered by a Status, and the rest stays readable.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.hpp"

namespace rcb::service {

class ReportFile {
 public:
  explicit ReportFile(std::string path) : path_(std::move(path)) {}
  ~ReportFile();
  ReportFile(const ReportFile&) = delete;
  ReportFile& operator=(const ReportFile&) = delete;

  // `lines`: the reports from number `first` on, each with its newline; above all that were appended. On failure none
  // of them is in the file. Errors: io_error.
  Status append(std::uint64_t first, const std::vector<std::string>& lines);
  std::uint64_t count() const { return count_; }  // reports that are in it
  // Calls visit(number, line) for those of the reports [first, last) that are in it, ascending. Errors: io_error; then
  // those behind the last visited can't be read.
  Status read(std::uint64_t first, std::uint64_t last,
              const std::function<void(std::uint64_t number, std::string_view line)>& visit) const;

 private:
  struct Run {  // of reports that follow one another, number and place
    std::uint64_t first = 0;
    std::uint64_t count = 0;
    std::uint64_t offset = 0;
  };

  // The file, still as this has left it; it is begun anew where somebody has changed or removed it. Errors: io_error.
  Result<int> open_to_append();
  Status read_run(int file, std::size_t run, std::uint64_t first, std::uint64_t last,
                  const std::function<void(std::uint64_t number, std::string_view line)>& visit) const;

  std::string path_;
  std::uint64_t size_ = 0;
  std::uint64_t count_ = 0;
  std::uint64_t inode_ = 0;  // 0: there is none yet
  std::vector<Run> runs_;
};

// An empty directory for such files, private; what an earlier run has left in it is removed. Errors: io_error.
Status make_report_directory(const std::string& path);
// Where a scene's lie in it.
std::string report_file_path(const std::string& directory, const std::string& scene);

}  // namespace rcb::service
