// Answers that rank 0 gives from a scene's ledger alone, without its ranks.
#pragma once

#include <functional>
#include <string>

#include "common/wire/message.hpp"
#include "server/api/answer.hpp"
#include "server/scene/ledger.hpp"

namespace rcb::api {

// What scene.show, scene.open and scene.create tell of a scene. ranks: of the service.
Answer describe(const scene::Ledger& ledger, int ranks);
// Answers error, counts, stats, history and the description. Errors: not_found (no positions yet), those of the
// request.
Answer answer_from(const scene::Ledger& ledger, const wire::Json& request, int ranks);
// The last step's report, for whoever has brought it and does so again.
std::string repeated(const scene::Ledger& ledger);

// An answer that `fill` completes with the reports [first, last); on the thread for files if they are in the file.
Answer with_reports(const scene::Ledger& ledger, std::uint64_t first, std::uint64_t last,
                    std::function<void(scene::FoundReports found, Answer& answer)> fill);

// What has the ranks take up a scene of an earlier service. The cuts, if any, go with it: cut_arrays().
wire::Json restore_order(const scene::Ledger& ledger);

// What a count is answered, as JSON, unless it is refused.
std::string verdict_text(const scene::Ledger& ledger, const scene::CountVerdict& verdict);

}  // namespace rcb::api
