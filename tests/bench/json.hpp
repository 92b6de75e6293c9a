// The benchmarks' documents keep the order in which their fields were written.
#pragma once

#include <nlohmann/json.hpp>

namespace rcb::bench {

using Json = nlohmann::ordered_json;

}  // namespace rcb::bench
