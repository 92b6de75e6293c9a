// Numbers of bytes as people write them: 65536, 512mb, 4gb.
#pragma once

#include <cstdint>
#include <string_view>

#include "common/base/status.hpp"

namespace rcb {

// The memory of this machine.
std::uint64_t machine_bytes();

// Digits and, after them, one of b, kb, mb, gb, tb (powers of 1024, in either case; kib and so on mean the same).
// Errors: invalid_argument: anything else, 0, more than the memory of this machine.
Result<std::uint64_t> read_memory_size(std::string_view text);

}  // namespace rcb
