// What a log says about an end: the last lines that a program wrote, without mpirun's boilerplate.
#pragma once

#include <string>

namespace rcb::launch {

// The last few telling lines of a text, joined by newlines; empty if none.
std::string telling_lines(const std::string& text);
// Of a file; empty where it can't be read.
std::string log_tail(const std::string& path);

}  // namespace rcb::launch
