// Names of columns in a comment: "# id x y", as numpy.savetxt(header=...) writes them.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "common/io/formats/columns.hpp"

namespace rcb::io {

// The names that a comment gives the columns; empty if none does. lines: those before the first row.
//
// A comment can give names if it has as many fields as a row, with any separator, and none of them is a number. Before
// them may stand a word with a colon ("# columns: x y z"), between them units in brackets ("# x [m]  y [m]"). It is
// taken for a sentence if one of them is a word like "of" or "by". Otherwise it gives names
// 1. if one of them is x, or a column that the options ask for;
// 2. if one is id, they are in quotes, or words with commas, semicolons or tabs between;
// 3. or if more than half of them look like names: at most two letters (vx), a digit, underscore or bracket inside
//    (pos_x, t[s]), or a usual quantity (radius).
// Of several comments the last that fulfils 1, else the last.
std::vector<std::string> names_in_comments(std::string_view lines, std::size_t column_count,
                                           const ReadOptions& options);

}  // namespace rcb::io
