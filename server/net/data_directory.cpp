#include "server/net/data_directory.hpp"

#include <array>
#include <cerrno>
#include <cstring>
#include <utility>
#include <vector>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/own_files.hpp"
#include "common/base/paths.hpp"

namespace rcb::net {
namespace {

constexpr std::size_t kTokenBytes = 32;

std::string reason() { return std::strerror(errno); }

// What the file holds, at most 4 KiB; empty where it can't be read.
std::string read_small(int file) {
  std::array<char, 4096> bytes;
  const ssize_t count = ::pread(file, bytes.data(), bytes.size(), 0);
  return count <= 0 ? "" : std::string(bytes.data(), static_cast<std::size_t>(count));
}

bool write_whole(int file, std::string_view text) {
  while (!text.empty()) {
    const ssize_t count = ::write(file, text.data(), text.size());
    if (count < 0 && errno == EINTR) continue;
    if (count <= 0) return false;
    text.remove_prefix(static_cast<std::size_t>(count));
  }
  return true;
}

// A file of ours, open to nobody else, that holds a token.
std::string private_token(const std::string& path) {
  const auto file = open_own_file(path, O_RDONLY);
  if (!file.ok()) return "";
  struct stat info {};
  std::string token;
  if (::fstat(*file, &info) == 0 && (info.st_mode & 0077) == 0) token = read_small(*file);
  ::close(*file);
  while (!token.empty() && token.back() == '\n') token.pop_back();
  const bool whole =
      token.size() == 2 * kTokenBytes && token.find_first_not_of("0123456789abcdef") == std::string::npos;
  return whole ? token : "";
}

// Writes a file of mode 0600 by way of a temporary name, so that no reader sees half of it.
Status write_private(const std::string& path, std::string_view text) {
  const std::string temporary = fmt::format("{}.{}", path, ::getpid());
  ::unlink(temporary.c_str());
  const int file = ::open(temporary.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, 0600);
  if (file < 0) return {Code::io_error, fmt::format("can't write {}: {}", temporary, reason())};
  const bool written = write_whole(file, text) && ::fsync(file) == 0;
  const std::string why = written ? "" : reason();
  ::close(file);
  if (written && ::rename(temporary.c_str(), path.c_str()) == 0) return {};
  const Status failed(Code::io_error, fmt::format("can't write {}: {}", path, written ? reason() : why));
  ::unlink(temporary.c_str());
  return failed;
}

}  // namespace

std::string random_hex(std::size_t bytes) {
  std::vector<unsigned char> raw(bytes);
  CHECK(::getrandom(raw.data(), raw.size(), 0) == static_cast<ssize_t>(bytes), "the kernel gives no random bytes");
  std::string hex;
  for (const unsigned char byte : raw) hex += fmt::format("{:02x}", byte);
  return hex;
}

bool same_secret(std::string_view a, std::string_view b) {
  if (a.size() != b.size()) return false;
  unsigned difference = 0;
  for (std::size_t i = 0; i < a.size(); ++i)
    difference |= static_cast<unsigned>(static_cast<unsigned char>(a[i]) ^ static_cast<unsigned char>(b[i]));
  return difference == 0;
}

Result<DataDirectory> DataDirectory::open(const std::string& path, bool named_by_user, EndpointNote who) {
  const Status made = named_by_user ? make_own_directory(path) : make_private_directory(path);
  if (!made.ok()) return made;
  who.data_dir = path;
  DataDirectory directory(path);
  auto lock = take_data_directory(who);
  if (lock.ok())
    directory.lock_.emplace(std::move(*lock));
  else if (!held_by_supervisor(join_path(path, kLockFile)))
    return lock.status();
  const std::string marker = join_path(path, kCleanShutdownFile);
  if (::unlink(marker.c_str()) != 0 && errno != ENOENT)
    return Status(Code::io_error, fmt::format("can't remove {}: {}", marker, reason()));
  return directory;
}

Result<std::string> DataDirectory::token() const {
  const std::string path = join_path(path_, kTokenFile);
  if (std::string token = private_token(path); !token.empty()) return token;
  std::string token = random_hex(kTokenBytes);
  const Status written = write_private(path, token + "\n");
  if (!written.ok()) return written;
  return token;
}

Result<OfferedToken> OfferedToken::offer(const std::string& directory, std::string token) {
  if (Status made = make_private_directory(directory); !made.ok()) return made;
  const std::string path = join_path(directory, kTokenFile);
  if (Status written = write_private(path, token + "\n"); !written.ok()) return written;
  return OfferedToken(path, std::move(token));
}

OfferedToken::OfferedToken(OfferedToken&& other) noexcept
    : path_(std::exchange(other.path_, "")), token_(std::move(other.token_)) {}

OfferedToken::~OfferedToken() {
  if (!path_.empty() && private_token(path_) == token_) ::unlink(path_.c_str());
}

Status DataDirectory::leave_clean_marker() const {
  const Status written = write_private(join_path(path_, kCleanShutdownFile), "");
  if (!written.ok()) return written;
  const int directory = ::open(path_.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (directory < 0) return {};
  ::fsync(directory);
  ::close(directory);
  return {};
}

}  // namespace rcb::net
