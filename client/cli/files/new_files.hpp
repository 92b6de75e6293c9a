// Files that appear in a folder together, or none of them: they are written into a hidden folder in it, and renamed
// once all are whole.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "common/base/status.hpp"

namespace rcb::cli {

class NewFiles {
 public:
  // Makes the folder if it is missing. Errors: io_error.
  static Result<NewFiles> begin(const std::string& directory);
  NewFiles(NewFiles&& other) noexcept
      : directory_(std::move(other.directory_)), hidden_(std::exchange(other.hidden_, {})), made_(other.made_) {}
  NewFiles& operator=(NewFiles&&) = delete;
  ~NewFiles();  // removes what was not committed, and the folder if it was made for that

  const std::string& hidden() const { return hidden_; }  // the folder in which to write them
  // Gives them their places; what has such a name is replaced. Errors: io_error.
  Status commit(const std::vector<std::string>& names);

 private:
  NewFiles(std::string directory, std::string hidden, bool made)
      : directory_(std::move(directory)), hidden_(std::move(hidden)), made_(made) {}

  std::string directory_;
  std::string hidden_;  // empty: nothing is left to be removed
  bool made_;           // the directory was not there before
};

}  // namespace rcb::cli
