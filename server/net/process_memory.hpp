// How much memory this process takes.
#pragma once

#include <cstdint>

namespace rcb::net {

// Bytes that are in memory now, shared ones included; 0 where the system doesn't tell.
std::uint64_t resident_bytes();

}  // namespace rcb::net
