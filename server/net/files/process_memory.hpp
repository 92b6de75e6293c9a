// How much memory this process takes.
#pragma once

#include <cstdint>

namespace rcb::net {

// Resident memory in bytes, shared pages included; 0 if the system doesn't tell.
std::uint64_t resident_bytes();

}  // namespace rcb::net
