// Answers that tell of step reports, of which older ones are in a file.
#pragma once

#include <functional>

#include "server/api/answer.hpp"
#include "server/scene/ledger.hpp"

namespace rcb::api {

// An answer that `fill` completes with the reports [first, last); on the thread for files if they are in the file.
Answer with_reports(const scene::Ledger& ledger, std::uint64_t first, std::uint64_t last,
                    std::function<void(scene::FoundReports found, Answer& answer)> fill);

}  // namespace rcb::api
