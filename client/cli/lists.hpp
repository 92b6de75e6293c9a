// Long lists by part come beside an answer's JSON, as arrays (PROTOCOL.md, "Long lists"). Here they are put where the
// JSON has their names, so that whoever reads an answer finds the same document however many parts there are.
#pragma once

#include <nlohmann/json.hpp>

#include "client/lib/client.hpp"

namespace rcb::cli {

void fill_lists(nlohmann::ordered_json& json, const client::Reply& reply);

}  // namespace rcb::cli
