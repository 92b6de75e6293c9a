// JobFolder: a folder that a job has on one of its machines, with a new name each time, for Open MPI's session files and
// the ranks' shared memory. On the machine where the job was started its launcher has one; on any other each rank.
//
// Invariants
// 1. It lies in /dev/shm, where neither a full disk nor a removed data directory affects it; if there is no room, in
//    the fallback folder.
// 2. While its owner lives, the owner's note in it is locked. A folder whose note isn't locked is left over, and is
//    removed by the next process that starts or stops a service on that machine, for whatever endpoint (sweep()).
#pragma once

#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "common/files/endpoint_lock.hpp"
#include "common/files/lock_file.hpp"

namespace rcb {

class JobFolder {
 public:
  // Errors: io_error.
  static Result<JobFolder> make(const std::string& fallback, int ranks);
  JobFolder(JobFolder&& other) noexcept;
  JobFolder& operator=(JobFolder&&) = delete;
  ~JobFolder();

  const std::string& path() const { return path_; }
  // Writes whose job it is, so that a sweep which finds the folder left over can also remove the endpoint's sockets.
  void sign(const EndpointNote& owner) const;
  // For a rank's folder. `session`: Open MPI's session folder on this machine, which such a sweep removes, too, unless a
  // rank that lives has named the same.
  void sign_for_rank(const std::string& session) const;

  // Removes what killed jobs of this user have left on this machine: their folders in /dev/shm and in `fallback`, their
  // sockets and Open MPI's files. Returns the paths.
  static std::vector<std::string> sweep(const std::string& fallback);

 private:
  JobFolder(std::string path, LockFile lock) : path_(std::move(path)), lock_(std::move(lock)) {}
  static Result<JobFolder> make_in(const std::string& parent);
  std::string path_;
  LockFile lock_;
};

}  // namespace rcb
