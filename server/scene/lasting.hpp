// What of a ledger lasts beyond its process, as bytes for the journal, and back. The bytes are MessagePack.
//
// Everything that is read back may be anything: it is checked, and what can't be a scene's is refused.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "common/cuts/cut_arrays.hpp"
#include "server/scene/ledger.hpp"

namespace rcb::scene {

// What seldom changes; the rest is written with it at each step.
std::string encode_frame(const SceneState& now);
std::string encode(const Lasting& lasting, const std::string& frame);
// incarnation: of the folder. Errors: io_error.
Result<Lasting> decode_lasting(std::string_view bytes, std::uint64_t incarnation);

std::string encode(const cuts::CutTree& tree);
// Errors: io_error.
Result<cuts::CutTree> decode_tree(std::string_view bytes);

}  // namespace rcb::scene
