// DataDirectory: the directory of one service: lock, token, clean-shutdown marker.
//
// Invariants
// 1. While this lives no other service has the directory: its lock is held, here or by this rank's supervisor.
// 2. The marker is absent from open() to leave_clean_marker().
#pragma once

#include <optional>
#include <string>

#include "common/base/endpoint_lock.hpp"
#include "common/base/status.hpp"

namespace rcb::net {

class DataDirectory {
 public:
  // Makes `path` where it isn't there; closes it to others unless `named_by_user`. `who` is written into the lock file
  // for the one who is refused. Errors: busy (names the live service), io_error, not_authorised.
  static Result<DataDirectory> open(const std::string& path, bool named_by_user, EndpointNote who);

  const std::string& path() const { return path_; }
  // Makes a token anew: what an earlier service's clients know is of no use at this one. Errors: io_error.
  Result<std::string> new_token() const;
  // The token in it, for a service that goes on after a crash; a new one where there is none that is private and whole.
  Result<std::string> kept_token() const;
  // Says that the service ended as told; synced to disk. Errors: io_error.
  Status leave_clean_marker() const;

 private:
  explicit DataDirectory(std::string path) : path_(std::move(path)) {}
  std::string path_;
  std::optional<LockFile> lock_;  // none where the supervisor has it
};

// A copy of a service's token where clients on this machine look for it: in its endpoint's default data directory, for
// services whose own lies elsewhere. It goes with this, unless another service has put its own there.
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
