// Text of others on its way to a log or a terminal, where control characters would forge lines or drive the terminal.
#pragma once

#include <string>
#include <string_view>

namespace rcb {

// C0 and C1 control characters (the latter as UTF-8 writes them), and delete.
bool has_controls(std::string_view text);
// With each byte of a control character written as \xHH, but for those in `kept`.
std::string escape_controls(std::string_view text, std::string_view kept = {});

}  // namespace rcb
