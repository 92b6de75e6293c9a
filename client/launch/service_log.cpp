#include "client/launch/service_log.hpp"

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include "client/launch/log_tail.hpp"
#include "common/files/own_files.hpp"
#include "common/files/read_write.hpp"

namespace rcb::launch {
namespace {

constexpr std::size_t kRecentBytesMax = 64 * 1024;

std::string time_stamp() {
  const std::time_t now = std::time(nullptr);
  std::tm utc{};
  gmtime_r(&now, &utc);
  char stamp[32] = {};
  std::strftime(stamp, sizeof stamp, "%Y-%m-%dT%H:%M:%SZ", &utc);
  return stamp;
}

}  // namespace

ServiceLog::ServiceLog(std::string path, std::uint64_t bytes_max) : path_(std::move(path)), bytes_max_(bytes_max) {}

Status ServiceLog::open() {
  auto file = open_own_file(path_, O_WRONLY | O_CREAT | O_APPEND);
  if (!file.ok()) return file.status();
  file_ = std::move(*file);
  struct stat info {};
  bytes_ = ::fstat(file_.get(), &info) == 0 ? static_cast<std::uint64_t>(info.st_size) : 0;
  if (bytes_ > bytes_max_) rotate();
  return {};
}

bool ServiceLog::in_place() const {
  struct stat opened {};
  struct stat named {};
  return file_.open() && ::fstat(file_.get(), &opened) == 0 && ::lstat(path_.c_str(), &named) == 0 &&
         opened.st_dev == named.st_dev && opened.st_ino == named.st_ino;
}

Status ServiceLog::refresh() { return in_place() ? Status{} : open(); }

void ServiceLog::rotate() {
  // If it can't be renamed, its content is discarded all the same, so that its size stays limited.
  const std::string old = path_ + ".1";
  if (!in_place() || std::rename(path_.c_str(), old.c_str()) != 0) {
    if (::ftruncate(file_.get(), 0) == 0) bytes_ = 0;
    return;
  }
  auto file = open_own_file(path_, O_WRONLY | O_CREAT | O_APPEND);
  if (!file.ok()) return;  // goes on with the renamed file
  file_ = std::move(*file);
  bytes_ = 0;
}

void ServiceLog::write(std::string_view bytes) {
  const std::size_t written = file_.open() ? write_some(file_.get(), bytes) : 0;
  bytes_ += written;
  if (written == bytes.size()) return;
  lost_bytes_ += bytes.size() - written;
  lost_reason_ = file_.open() ? std::strerror(errno) : "no file";
}

void ServiceLog::add(std::string_view bytes) {
  recent_.append(bytes);
  if (recent_.size() > 2 * kRecentBytesMax) recent_.erase(0, recent_.size() - kRecentBytesMax);
  append(bytes);
}

void ServiceLog::append(std::string_view bytes) {
  if (bytes.empty()) return;
  if (bytes_ > bytes_max_) rotate();
  if (lost_bytes_ > 0) {
    const std::uint64_t lost = std::exchange(lost_bytes_, 0);
    const std::string why = lost_reason_;
    write(fmt::format("\n({} bytes of the log are missing here: {})\n", lost, why));
    if (lost_bytes_ > 0) lost_bytes_ = lost;
  }
  write(bytes);
  line_open_ = bytes.back() != '\n';
}

void ServiceLog::note(std::string_view text) {
  append(fmt::format("{}{} rcbctl up: {}\n", line_open_ ? "\n" : "", time_stamp(), text));
}

std::string ServiceLog::tail() const { return telling_lines(recent_); }

}  // namespace rcb::launch
