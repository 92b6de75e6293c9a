// JobFolder: a job's own folder, with a new name each time, for Open MPI's session files and the ranks' sockets, and
// for the memory that ranks share where System V's can't hold it.
//
// Invariants
// 1. It lies in /dev/shm, where neither a full disk nor a removed data directory affects it; if there is no room, in
//    the fallback folder.
// 2. While its owner lives, the owner's note in it is locked. A folder whose note isn't locked is left over, and is
//    removed by the next process that starts or stops a service, for whatever endpoint (sweep()).
#pragma once

#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "common/files/endpoint_lock.hpp"
#include "common/files/lock_file.hpp"

namespace rcb::launch {

class JobFolder {
 public:
  // Errors: io_error.
  static Result<JobFolder> make(const std::string& fallback, int ranks);
  JobFolder(JobFolder&& other) noexcept;
  JobFolder& operator=(JobFolder&&) = delete;
  ~JobFolder();

  const std::string& path() const { return path_; }
  // Whether the ranks are to share memory through files in it, since the limits of System V's are too low.
  bool holds_memory() const { return holds_memory_; }
  // Writes whose job it is, so that a sweep which finds the folder left over can also remove the endpoint's sockets.
  void sign(const EndpointNote& owner) const;

  // Removes what killed jobs of this user have left: their folders in /dev/shm and in `fallback`, and their sockets.
  // Returns the paths.
  static std::vector<std::string> sweep(const std::string& fallback);

 private:
  JobFolder(std::string path, bool holds_memory, LockFile lock)
      : path_(std::move(path)), holds_memory_(holds_memory), lock_(std::move(lock)) {}
  static Result<JobFolder> make_in(const std::string& parent, bool holds_memory);
  std::string path_;
  bool holds_memory_;
  LockFile lock_;
};

}  // namespace rcb::launch
