#include "server/net/files/data_directory.hpp"

#include <cerrno>
#include <cstring>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/auth/proof.hpp"
#include "common/files/own_files.hpp"
#include "common/files/paths.hpp"
#include "common/files/read_write.hpp"

namespace rcb::net {
namespace {

constexpr std::size_t kTokenBytes = 32;
constexpr std::size_t kTokenFileBytesMax = 4096;

std::string reason() { return std::strerror(errno); }

// The token in a file that belongs to this user and is closed to all others; else empty.
std::string private_token(const std::string& path) {
  const auto file = open_own_file(path, O_RDONLY);
  if (!file.ok()) return "";
  struct stat info {};
  std::string token;
  if (::fstat(file->get(), &info) == 0 && (info.st_mode & 0077) == 0)
    token = read_some(file->get(), kTokenFileBytesMax);
  while (!token.empty() && token.back() == '\n') token.pop_back();
  const std::size_t begin = auth::trusts_network(token) ? auth::kTrustedNetworkPrefix.size() : 0;
  const bool whole = token.size() == begin + 2 * kTokenBytes &&
                     token.find_first_not_of("0123456789abcdef", begin) == std::string::npos;
  return whole ? token : "";
}

}  // namespace

Result<DataDirectory> DataDirectory::open(const std::string& path, bool named_by_user, EndpointNote who) {
  const Status made = named_by_user ? make_own_directory(path) : make_private_directory(path);
  if (!made.ok()) return named_by_user ? made : naming("--data-dir", made);
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

Result<std::string> DataDirectory::new_token(std::string_view prefix) const {
  std::string token = std::string(prefix) + auth::random_hex(kTokenBytes);
  const Status written = write_own_file(join_path(path_, kTokenFile), token + "\n");
  if (!written.ok()) return written;
  return token;
}

Result<std::string> DataDirectory::kept_token(std::string_view prefix) const {
  std::string token = private_token(join_path(path_, kTokenFile));
  return token.starts_with(prefix) && token.size() == prefix.size() + 2 * kTokenBytes ? token : new_token(prefix);
}

Result<OfferedToken> OfferedToken::offer(const std::string& directory, std::string token) {
  if (Status made = make_private_directory(directory); !made.ok()) return made;
  const std::string path = join_path(directory, kTokenFile);
  if (Status written = write_own_file(path, token + "\n"); !written.ok()) return written;
  return OfferedToken(path, std::move(token));
}

OfferedToken::OfferedToken(OfferedToken&& other) noexcept
    : path_(std::exchange(other.path_, "")), token_(std::move(other.token_)) {}

OfferedToken::~OfferedToken() {
  if (!path_.empty() && private_token(path_) == token_) ::unlink(path_.c_str());
}

Status leave_end_marker(const std::string& path) {
  const Status written = write_own_file(join_path(path, kCleanShutdownFile), "");
  if (!written.ok()) return written;
  const Descriptor directory(::open(path.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (directory.open()) ::fsync(directory.get());
  return {};
}

}  // namespace rcb::net
