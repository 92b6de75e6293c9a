// Text for people. From outside it is made safe to write to a log or a terminal, where control characters could forge
// lines or drive the terminal.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>

namespace rcb {

// True if the text has a control character: C0, C1 (as UTF-8 encodes it) or delete.
bool has_controls(std::string_view text);
// Replaces each byte of a control character by \xHH, except for the characters in `kept`.
std::string escape_controls(std::string_view text, std::string_view kept = {});

// Behind a list of names that isn't whole: " and 3 more"; "" for 0.
std::string and_more(std::size_t more);

}  // namespace rcb
