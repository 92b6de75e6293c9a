// Files of formats that can't be read here, recognised by their content (text by its first lines), so that the error
// says what the file is and what to do with it, instead of what is wrong with it as CSV.
#pragma once

#include <string>
#include <string_view>

#include "common/base/status.hpp"
#include "common/io/files/input_file.hpp"

namespace rcb::io {

// Errors: invalid_argument, naming format and remedy; those of reading the file's beginning.
Status check_not_foreign(const InputFile& file);

}  // namespace rcb::io
