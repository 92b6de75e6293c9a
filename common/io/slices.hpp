// Slices of a file whose format its first bytes tell: what read_points_slice and open_trajectory share.
#pragma once

#include <cstdint>
#include <exception>
#include <new>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "common/base/status.hpp"
#include "common/io/files/input_file.hpp"
#include "common/io/formats/columns.hpp"
#include "common/io/formats/fields.hpp"

namespace rcb::io {

inline bool ends_with_npy(const std::string& path) { return lowered(path).ends_with(".npy"); }

Result<InputFile> open_file(const std::string& path, const ReadOptions& options);
// As read_points_slice, but may throw.
Result<Points> read_slice(InputFile file, const ReadOptions& options, int k, int of);
Result<Points> read_slice(const std::string& path, const ReadOptions& options, int k, int of);

// The ids of rows that have numbers, not lines.
Status check_distinct(const std::string& file, const std::vector<std::int64_t>& ids);

template <typename Read>
auto without_throwing(const std::string& path, const Read& read) -> decltype(read()) {
  try {
    return read();
  } catch (const std::bad_alloc&) {
    return Status(Code::too_large, path + ": no memory for its points", "give it to more ranks or a larger machine");
  } catch (const std::exception& error) {
    return Status(Code::internal, fmt::format("{}: {}", path, error.what()));
  }
}

}  // namespace rcb::io
