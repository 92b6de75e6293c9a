// The JSON of a cut tree: cuts in preorder, regions by part, hash.
#pragma once

#include "common/partition/cut_tree.hpp"
#include "common/wire/message.hpp"

namespace rcb::service {

wire::Json cuts_json(const partition::CutTree& tree, std::uint64_t epoch);

}  // namespace rcb::service
