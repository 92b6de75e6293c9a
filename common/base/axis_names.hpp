// The names of the axes in files, messages and the protocol.
#pragma once

namespace rcb {

inline constexpr const char* kAxisNames[] = {"x", "y", "z"};

}  // namespace rcb
