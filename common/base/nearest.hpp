// Finds the names that a mistyped one may stand for, for hints in error messages.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>
#include <vector>

namespace rcb {

// The number of single characters to insert, delete, replace or swap with their neighbour that turns a into b (optimal
// string alignment distance).
std::size_t edit_distance(std::string_view a, std::string_view b);

// The names that the user may have meant by `word`, nearest first: those that begin with `word`, and those whose
// distance is at most 1 or a third of the length of `word`.
std::vector<std::string> names_like(std::string_view word, const std::vector<std::string>& names);

}  // namespace rcb
