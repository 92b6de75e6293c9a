// The last lines that a failed program wrote to its log, without mpirun's boilerplate.
#pragma once

#include <string>

namespace rcb::launch {

// The last few informative lines of a text, joined by newlines; empty if there are none.
std::string telling_lines(const std::string& text);
// telling_lines() of the end of a file; empty if it can't be read.
std::string log_tail(const std::string& path);

}  // namespace rcb::launch
