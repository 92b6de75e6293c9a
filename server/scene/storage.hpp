// Storage: the few things that a journal asks of a file system, so that tests can put one in its place that is full,
// fails or ends in the middle of a copy, thousands of times from a seed. disk_storage() is the real one.
//
// Invariants
// 1. Files are mapped, and what is stored outlives the process without a further call, since the pages are the
// kernel's.
//    Nothing is synced: it does not outlive the machine.
// 2. A file that may be written has a place on the disk for each of its bytes: storing into a hole of a full disk would
//    end the process by SIGBUS. (File systems that copy on write, such as Btrfs and ZFS, don't promise as much.)
// 3. So would reading behind the end of a file that somebody has shortened since it was mapped. The data directory is
//    the service's own, with a lock in it, and nobody else can write there (own_files.hpp).
#pragma once

#include <cstddef>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.hpp"

namespace rcb::scene {

class MappedFile {
 public:
  virtual ~MappedFile() = default;
  virtual std::string_view bytes() const = 0;
  // Copies `bytes` into the file; they fit. A process that is killed meanwhile leaves any of them stored, others not.
  virtual void store(std::size_t at, std::string_view bytes) = 0;
};

// Errors of all: io_error (no room, a fault of the disk), not_found, not_authorised (another user's, a link, another
// kind of file); too_large (open_file).
class Storage {
 public:
  static constexpr std::size_t kFileBytesMax = std::size_t{512} << 20U;
  enum class Access { read, write };

  virtual ~Storage() = default;
  // Makes it and its missing parents, of mode 0700; one that is there is checked: whether others could change it.
  virtual Status make_folder(const std::string& path) = 0;
  // None if it isn't there.
  virtual Result<std::vector<std::string>> names_in(const std::string& folder) const = 0;
  // A new file of zeros, of mode 0600, in place of what is there.
  virtual Result<std::unique_ptr<MappedFile>> make_file(const std::string& path, std::size_t bytes) = 0;
  virtual Result<std::unique_ptr<MappedFile>> open_file(const std::string& path, Access access) const = 0;
  // In place of a file that is there, at once.
  virtual Status rename(const std::string& from, const std::string& to) = 0;
  // A file, or an empty folder; fine if it isn't there.
  virtual Status remove(const std::string& path) = 0;
};

std::unique_ptr<Storage> disk_storage();

}  // namespace rcb::scene
