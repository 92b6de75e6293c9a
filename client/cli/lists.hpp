// Long lists by part come as arrays beside an answer's JSON (PROTOCOL.md, "Long lists"). Here they are inserted where
// the JSON has their names, so that the document looks the same for any number of parts.
#pragma once

#include <nlohmann/json.hpp>

#include "client/lib/client.hpp"

namespace rcb::cli {

void fill_lists(nlohmann::ordered_json& json, const client::Reply& reply);

// Numbers of a list by part: null becomes NaN, and "inf" infinity.
std::vector<double> numbers(const nlohmann::ordered_json& list);

}  // namespace rcb::cli
