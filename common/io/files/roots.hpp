// Roots: the folders below which files are read and written on behalf of clients.
//
// Invariants
// 1. What counts is where a path leads, not how it is written: it is resolved, and must then lie below a root.
// 2. What is opened is what was resolved: name by name from the root's descriptor, none of them a symbolic link. So
//    what is swapped meanwhile leads nowhere else.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "common/base/status.hpp"
#include "common/files/descriptor.hpp"
#include "common/io/files/input_file.hpp"

namespace rcb::io {

// An open directory.
class Folder {
 public:
  Folder(std::string path, int descriptor) : path_(std::move(path)), descriptor_(descriptor) {}
  const std::string& path() const { return path_; }
  int descriptor() const { return descriptor_.get(); }

 private:
  std::string path_;
  Descriptor descriptor_;
};

class Roots {
 public:
  Roots() = default;  // nothing may be opened
  // Errors: io_error, which names the folder.
  Status add(const std::string& folder);

  // A file to read. Errors: not_authorised where it isn't below a root; those of InputFile::open.
  Result<InputFile> open_file(const std::string& path) const;
  // A folder to write in, created if missing. Errors: not_authorised, io_error.
  Result<Folder> make_folder(const std::string& path) const;

 private:
  struct Place;
  Result<Place> place_of(const std::string& path) const;

  std::vector<Folder> folders_;
};

}  // namespace rcb::io
