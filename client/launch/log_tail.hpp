// What a log says about an end: the last lines that a program wrote, without mpirun's boilerplate.
#pragma once

#include <cstdint>
#include <string>

namespace rcb::launch {

// Bytes in the file now; 0 if there is none.
std::uint64_t file_bytes(const std::string& path);

// The last few telling lines written at or after byte `from`, joined by newlines; empty if none.
std::string log_tail(const std::string& path, std::uint64_t from);

}  // namespace rcb::launch
