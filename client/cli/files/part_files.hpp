// A folder of part files: part-0.csv and so on, as `export` and `partition --out` write them. Files left by an earlier
// partition could be mistaken for the new ones: so they are refused, or removed on request. No other file is ever
// removed.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "client/cli/files/fetched.hpp"
#include "common/base/status.hpp"

namespace rcb::cli {

std::vector<std::string> part_file_names(int parts);
// "part-07.csv" and its like, for any number of parts.
bool is_part_file_name(const std::string& name);

class LeftoverFiles {
 public:
  // Finds the files in `directory` that an export may have written, except those of `written` (to be written). Errors:
  // already_exists, if there are some and `replace` is false; io_error. Likewise if arrays of an export would be
  // overwritten that stand there without the others, so that no export has written them.
  static Result<LeftoverFiles> find(const std::string& directory, const std::vector<std::string>& written,
                                    bool replace);
  // To be called after the new files are complete. Errors: io_error.
  Status remove() const;

 private:
  std::vector<std::string> paths_;
};

// Columns that the part files have beside those of the service.
struct Beside {
  std::string names;                    // as in io::FurtherColumns
  std::vector<std::string_view> cells;  // likewise, for each particle of the set; empty: none
};
// Writes one CSV for each part. The directory must exist.
Status write_part_files(const Fetched& set, int parts, const std::string& directory, const Beside& beside = {});

}  // namespace rcb::cli
