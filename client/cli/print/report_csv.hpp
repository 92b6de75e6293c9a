// Step reports as CSV: the columns are the fields of the JSON report; its seconds become seconds_receive and so on.
#pragma once

#include <string>

#include <nlohmann/json.hpp>

namespace rcb::cli {

// Both end with a newline.
std::string reports_csv_header();
std::string report_csv_line(const nlohmann::ordered_json& report);

}  // namespace rcb::cli
