// Converts a number that may be signed, such as a part, a rank or an axis, to an array index.
#pragma once

#include <concepts>
#include <cstddef>

namespace rcb {

constexpr std::size_t at(std::integral auto index) { return static_cast<std::size_t>(index); }

}  // namespace rcb
