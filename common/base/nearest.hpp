// Names like a mistyped one, for hints.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>
#include <vector>

namespace rcb {

// How many single characters must be inserted, removed, replaced or swapped with their neighbour to make b of a
// (optimal string alignment distance).
std::size_t edit_distance(std::string_view a, std::string_view b);

// The names of which `word` may be a mistyping, the nearest first: up to a third of its characters differ, but at
// least one may, or it is their beginning.
std::vector<std::string> names_like(std::string_view word, const std::vector<std::string>& names);

}  // namespace rcb
