// ReportFile: the older reports of one scene, one JSON document a line, in their order. The file is made with the first
// report, open only during reads and writes, and removed by the destructor.
//
// Invariants
// 1. The parts of the file that `runs_` describes are whole lines; reports between two runs are not in the file.
// 2. Any fault of the disk or the file is returned as a Status; the other reports stay readable.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.hpp"
#include "common/files/descriptor.hpp"

namespace rcb::scene {

class ReportFile {
 public:
  explicit ReportFile(std::string path) : path_(std::move(path)) {}
  ~ReportFile();
  ReportFile(const ReportFile&) = delete;
  ReportFile& operator=(const ReportFile&) = delete;

  // Appends the reports numbered from `first` on, each a line with its newline; `first` is above all numbers so far. On
  // failure none of them is in the file. Errors: io_error.
  Status append(std::uint64_t first, const std::vector<std::string>& lines);
  std::uint64_t count() const { return count_; }  // reports in the file
  // Calls visit(number, line) for those of the reports [first, last) that are in the file, ascending. Errors: io_error;
  // the reports after the last one visited can't be read then.
  Status read(std::uint64_t first, std::uint64_t last,
              const std::function<void(std::uint64_t number, std::string_view line)>& visit) const;

 private:
  struct Run {  // reports with consecutive numbers, and their place in the file
    std::uint64_t first = 0;
    std::uint64_t count = 0;
    std::uint64_t offset = 0;
  };

  // Opens the file if it is as append() left it; begins it anew if it was changed or removed. Errors: io_error.
  Result<Descriptor> open_to_append();
  Status read_run(int file, std::size_t run, std::uint64_t first, std::uint64_t last,
                  const std::function<void(std::uint64_t number, std::string_view line)>& visit) const;

  std::string path_;
  std::uint64_t size_ = 0;
  std::uint64_t count_ = 0;
  std::uint64_t inode_ = 0;  // 0: no file yet
  std::vector<Run> runs_;
};

// Makes a private directory for report files, and removes those of an earlier run. Errors: io_error.
Status make_report_directory(const std::string& path);
// The path of a scene's report file.
std::string report_file_path(const std::string& directory, const std::string& scene);

}  // namespace rcb::scene
