// A folder of part files: part-0.csv and so on, as `export` and `partition --out` write it. What an earlier partition
// left in it would pass for this one's, so it is refused, or removed on request. No other file is ever removed.
#pragma once

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "client/cli/fetched.hpp"
#include "common/base/status.hpp"

namespace rcb::cli {

std::vector<std::string> part_file_names(int parts);

class LeftFiles {
 public:
  // The files in `directory` that are called as an export calls them and are not among `written`. Errors:
  // already_exists, where there are some and `replace` doesn't ask for their removal; io_error.
  static Result<LeftFiles> find(const std::string& directory, const std::vector<std::string>& written, bool replace);
  // After the new ones are complete. Errors: io_error.
  Status remove() const;

 private:
  std::vector<std::string> paths_;
};

// One CSV a part; appends their paths to `files`. The directory exists.
Status write_part_files(const Fetched& set, int parts, const std::string& directory, nlohmann::ordered_json& files);

}  // namespace rcb::cli
