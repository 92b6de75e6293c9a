// Answers that tell of step reports, of which older ones are in a file.
#pragma once

#include <functional>

#include "server/service/context/context.hpp"

namespace rcb::service {

// An answer that `fill` completes with the reports [first, last); beside the engine if they are in the file, so that no
// scene waits for a disk. On rank 0.
Response with_reports(const History& history, std::uint64_t first, std::uint64_t last,
                      std::function<void(FoundReports found, Response& answer)> fill);

}  // namespace rcb::service
