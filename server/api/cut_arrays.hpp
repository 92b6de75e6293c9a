// A cut tree as the arrays of a message: axes, at, id and, unless parts are equal, part_sizes (PROTOCOL.md).
#pragma once

#include <vector>

#include "common/cuts/cut_tree.hpp"
#include "common/wire/message.hpp"

namespace rcb::api {

std::vector<wire::Array> cut_arrays(const cuts::CutTree& tree);

}  // namespace rcb::api
