// Room `files`: what the service has in the file system besides its scenes (data directory, names of sockets, log), and
// its memory use.
//
// DataDirectory: the directory of one service, with lock, token and the marker of a service that was told to end.
//
// Invariants
// 1. While this object lives no other service has the directory: its lock is held by this object or by this rank's
//    supervisor.
// 2. The marker is absent from open() to leave_end_marker().
#pragma once

#include <optional>
#include <string>
#include <string_view>

#include "common/base/status.hpp"
#include "common/files/endpoint_lock.hpp"

namespace rcb::net {

class DataDirectory {
 public:
  // Creates `path` if it isn't there; makes it inaccessible to other users unless `named_by_user`. `who` is written
  // into the lock file, where a service that is refused can read it. Errors: busy (names the live service), io_error,
  // not_authorised.
  static Result<DataDirectory> open(const std::string& path, bool named_by_user, EndpointNote who);

  const std::string& path() const { return path_; }
  // Writes a new token: clients of an earlier service that know the old one can't use this one. prefix: what it begins
  // with (auth::kTrustedNetworkPrefix). Errors: io_error.
  Result<std::string> new_token(std::string_view prefix = {}) const;
  // The token of the service before a crash; a new one if the file isn't private or isn't whole, or if the token has
  // another prefix. Errors: io_error.
  Result<std::string> kept_token(std::string_view prefix = {}) const;

 private:
  explicit DataDirectory(std::string path) : path_(std::move(path)) {}
  std::string path_;
  std::optional<LockFile> lock_;  // none if the supervisor holds it
};

// Records in a data directory that its service has been told to end, so that nobody starts it again, however it ends
// then; synced to disk. Errors: io_error.
Status leave_end_marker(const std::string& path);

// A copy of a service's token at the place where clients on this machine look for it, the default data directory of its
// endpoint; for services whose own directory lies elsewhere. The destructor removes the copy unless another service has
// replaced it.
class OfferedToken {
 public:
  // Errors: io_error, not_authorised.
  static Result<OfferedToken> offer(const std::string& directory, std::string token);
  OfferedToken(OfferedToken&& other) noexcept;
  OfferedToken& operator=(OfferedToken&&) = delete;
  ~OfferedToken();

 private:
  OfferedToken(std::string path, std::string token) : path_(std::move(path)), token_(std::move(token)) {}
  std::string path_;
  std::string token_;
};

}  // namespace rcb::net
