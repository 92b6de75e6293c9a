// JobFolder: a job's own folder, with a new name each time: Open MPI's session files and the ranks' shared memory.
//
// Invariants
// 1. It lies in /dev/shm, where a full disk or a removed data directory don't touch it; only where there is no room it
//    is made in the fallback folder.
// 2. As long as its owner lives, the owner's note in it is locked; a folder whose note isn't is left over, and is
// removed
//    by whoever starts a job next, for whatever endpoint (sweep()).
#pragma once

#include <string>
#include <vector>

#include "common/base/endpoint_lock.hpp"
#include "common/base/lock_file.hpp"
#include "common/base/status.hpp"

namespace rcb::launch {

class JobFolder {
 public:
  // Errors: io_error.
  static Result<JobFolder> make(const std::string& fallback, int ranks);
  JobFolder(JobFolder&& other) noexcept;
  JobFolder& operator=(JobFolder&&) = delete;
  ~JobFolder();

  const std::string& path() const { return path_; }
  // Whose job it is, for the one who finds it left over: the endpoint's sockets go with it.
  void sign(const EndpointNote& owner) const;

  // Removes what this user's killed jobs have left: their folders in /dev/shm and in `fallback`, and their sockets.
  // Returns the names.
  static std::vector<std::string> sweep(const std::string& fallback);

 private:
  JobFolder(std::string path, LockFile lock) : path_(std::move(path)), lock_(std::move(lock)) {}
  static Result<JobFolder> make_in(const std::string& parent);
  std::string path_;
  LockFile lock_;
};

}  // namespace rcb::launch
