#include "server/scene/report_file.hpp"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/files/own_files.hpp"
#include "common/files/paths.hpp"
#include "common/files/read_write.hpp"

namespace rcb::scene {
namespace {

constexpr const char* kSuffix = ".reports";
constexpr std::uint64_t kRunReports = 256;  // most reports in a run, hence most lines read to find one

Status failed_to(const char* what, const std::string& path, int fault) {
  return {Code::io_error, fmt::format("can't {} {}: {}", what, path, std::strerror(fault)),
          "make room in the service's data directory"};
}

}  // namespace

Status make_report_directory(const std::string& path) {
  if (Status made = make_own_directory(path); !made.ok()) return made;
  std::error_code fault;
  for (const std::string& name : names_in(path, fault))
    if (name.ends_with(kSuffix)) ::unlink(join_path(path, name).c_str());
  return fault ? failed_to("look into", path, fault.value()) : Status();
}

std::string report_file_path(const std::string& directory, const std::string& scene) {
  return join_path(directory, scene + kSuffix);
}

ReportFile::~ReportFile() {
  if (inode_ != 0) ::unlink(path_.c_str());
}

Result<Descriptor> ReportFile::open_to_append() {
  constexpr int kFlags = O_WRONLY | O_APPEND | O_CLOEXEC;
  if (inode_ != 0) {
    auto file = open_own_file(path_, kFlags);
    struct stat found {};
    if (file.ok() && ::fstat(file->get(), &found) == 0 && found.st_ino == inode_ &&
        static_cast<std::uint64_t>(found.st_size) == size_)
      return file;
    runs_.clear();
    size_ = count_ = inode_ = 0;
  }
  if (::unlink(path_.c_str()) != 0 && errno != ENOENT && errno != ENOTDIR) return failed_to("replace", path_, errno);
  if (Status made = make_own_directory(std::filesystem::path(path_).parent_path()); !made.ok()) return made;
  auto file = open_own_file(path_, kFlags | O_CREAT | O_EXCL);
  if (!file.ok()) return file.status();
  struct stat made {};
  if (::fstat(file->get(), &made) != 0) return failed_to("look at", path_, errno);
  inode_ = made.st_ino;
  return file;
}

Status ReportFile::append(std::uint64_t first, const std::vector<std::string>& lines) {
  const auto file = open_to_append();
  if (!file.ok()) return file.status();
  std::string text;
  const std::size_t runs_before = runs_.size();
  const std::uint64_t count_before = runs_.empty() ? 0 : runs_.back().count;
  for (std::size_t k = 0; k < lines.size(); ++k) {
    const bool follows = !runs_.empty() && runs_.back().first + runs_.back().count == first + k;
    if (!follows || runs_.back().count == kRunReports) runs_.push_back({first + k, 0, size_ + text.size()});
    ++runs_.back().count;
    text += lines[k];
  }
  if (!write_all(file->get(), text)) {
    const int fault = errno;
    runs_.resize(runs_before);
    if (!runs_.empty()) runs_.back().count = count_before;
    // If this fails too, the file is begun anew next time, since its size differs from size_.
    static_cast<void>(::ftruncate(file->get(), static_cast<off_t>(size_)));
    return failed_to("write", path_, fault);
  }
  size_ += text.size();
  count_ += lines.size();
  return {};
}

Status ReportFile::read(std::uint64_t first, std::uint64_t last,
                        const std::function<void(std::uint64_t, std::string_view)>& visit) const {
  auto run = std::upper_bound(runs_.begin(), runs_.end(), first,
                              [](std::uint64_t number, const Run& one) { return number < one.first + one.count; });
  if (run == runs_.end() || run->first >= last) return {};
  const auto file = open_own_file(path_, O_RDONLY | O_CLOEXEC);
  if (!file.ok()) return file.status();
  for (; run != runs_.end() && run->first < last; ++run)
    if (Status status = read_run(file->get(), static_cast<std::size_t>(run - runs_.begin()), first, last, visit);
        !status)
      return status;
  return {};
}

Status ReportFile::read_run(int file, std::size_t index, std::uint64_t first, std::uint64_t last,
                            const std::function<void(std::uint64_t, std::string_view)>& visit) const {
  const Run& run = runs_[index];
  const std::uint64_t end = index + 1 < runs_.size() ? runs_[index + 1].offset : size_;
  const std::string text = read_some(file, end - run.offset, run.offset);
  if (text.size() < end - run.offset) return failed_to("read", path_, errno);
  std::string_view rest = text;
  for (std::uint64_t number = run.first; number < run.first + run.count && number < last; ++number) {
    const std::size_t newline = rest.find('\n');
    if (newline == std::string_view::npos) return failed_to("read", path_, EIO);
    if (number >= first) visit(number, rest.substr(0, newline));
    rest.remove_prefix(newline + 1);
  }
  return {};
}

}  // namespace rcb::scene
