#include "common/io/files/input_file.hpp"

#include <cerrno>
#include <cstring>
#include <utility>
#include <vector>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

namespace rcb::io {
namespace {

// Without O_NONBLOCK the open of a FIFO would wait for its writer for ever.
constexpr int kFlags = O_RDONLY | O_CLOEXEC | O_NONBLOCK;

FileVersion version_of(const struct stat& about) {
  constexpr std::int64_t kNanoseconds = 1'000'000'000;
  return {about.st_ino, static_cast<std::uint64_t>(about.st_size),
          about.st_mtim.tv_sec * kNanoseconds + about.st_mtim.tv_nsec};
}

}  // namespace

Result<InputFile> InputFile::open(const std::string& path) {
  if (path.find('\0') != std::string::npos) return Status(Code::invalid_argument, "a file name holds a NUL byte");
  return take(Descriptor(::open(path.c_str(), kFlags)), path, "check the path; it is relative to this folder");
}

Result<InputFile> InputFile::open_in(int folder, const std::string& name, const std::string& path) {
  return take(Descriptor(::openat(folder, name.c_str(), kFlags | O_NOFOLLOW)), path);
}

Result<InputFile> InputFile::take(Descriptor descriptor, const std::string& path, const char* hint) {
  if (!descriptor.open()) {
    const int error = errno;
    if (error == ENOENT || error == ENOTDIR) return Status(Code::not_found, path + ": no such file", hint);
    return Status(Code::io_error, fmt::format("{}: can't be opened: {}", path, std::strerror(error)),
                  "check its permissions");
  }
  struct stat about {};
  if (::fstat(descriptor.get(), &about) != 0 || !S_ISREG(about.st_mode)) {
    const bool directory = S_ISDIR(about.st_mode);
    return Status(Code::io_error, path + (directory ? ": is a directory" : ": is not a regular file"),
                  directory ? "name a file in it" : "write the points to a file first");
  }
  char byte = 0;
  if (about.st_size == 0 && ::pread(descriptor.get(), &byte, 1, 0) > 0)  // as in /proc
    return Status(Code::io_error, path + ": is not a file whose size is known", "write the points to a file first");
  return InputFile(path, std::move(descriptor), version_of(about));
}

std::string InputFile::name_by_descriptor() const { return fmt::format("/proc/self/fd/{}", descriptor_.get()); }

InputFile::InputFile(std::string path, Descriptor descriptor, const FileVersion& version)
    : path_(std::move(path)), descriptor_(std::move(descriptor)), version_(version) {}

Status InputFile::read_at(std::uint64_t offset, void* to, std::size_t bytes) const {
  char* next = static_cast<char*>(to);
  while (bytes > 0) {
    if (Status stop = check_stop(); !stop.ok()) return stop;
    const ssize_t got = ::pread(descriptor_.get(), next, bytes, static_cast<off_t>(offset));
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) {
      return Status(Code::io_error,
                    fmt::format("{}: can't be read at byte {}: {}", path_, offset, std::strerror(errno)));
    }
    if (got == 0) {
      return Status(Code::io_error,
                    fmt::format("{}: ends at byte {}; it had {} bytes when opened", path_, offset, size()),
                    "wait until it is written, then try again");
    }
    next += got;
    offset += static_cast<std::uint64_t>(got);
    bytes -= static_cast<std::size_t>(got);
  }
  return {};
}

Status InputFile::check_unchanged() const {
  struct stat about {};
  if (::fstat(descriptor_.get(), &about) == 0 && version_of(about) == version_) return {};
  return {Code::io_error, path_ + ": was changed while it was read", "wait until it is written, then try again"};
}

bool InputFile::starts_with(std::string_view magic) const {
  if (size() < magic.size()) return false;
  std::vector<char> head(magic.size());
  return read_at(0, head.data(), head.size()).ok() && std::string_view(head.data(), head.size()) == magic;
}

std::string shown(std::string_view text) {
  constexpr std::size_t kShownMax = 40;
  std::string out;
  for (const char c : text.substr(0, kShownMax)) {
    const auto byte = static_cast<unsigned char>(c);
    if (byte < 0x20 || byte >= 0x7F) {
      out += fmt::format("\\x{:02x}", byte);
    } else {
      out += c;
    }
  }
  if (text.size() > kShownMax) out += "...";
  return out;
}

}  // namespace rcb::io
