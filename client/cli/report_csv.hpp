// Step reports as CSV: the columns are the fields of the JSON report, its seconds as seconds_receive and so on.
#pragma once

#include <string>

#include <nlohmann/json.hpp>

#include "common/base/status.hpp"

namespace rcb::cli {

// reports: an array of step reports. Written beside `path`, then renamed. Errors: io_error.
Status write_reports_csv(const std::string& path, const nlohmann::ordered_json& reports);

}  // namespace rcb::cli
