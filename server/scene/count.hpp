// CountRecord: what a solver counted, and from whom it came; and what follows from the counts of all parts.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "common/base/wide.hpp"
#include "common/partition/balance/load.hpp"
#include "common/wire/count_record.hpp"

namespace rcb::scene {

// XXH3-64 of a session's name, which takes less memory than the text.
std::uint64_t session_key(const std::string& session);

using wire::WeightCount;

// The record of one seat, or the sum of those of all seats.
struct CountRecord : wire::CountRecord {
  std::string session;
  std::uint64_t bytes = 0;              // of its frame
  std::vector<std::uint64_t> sessions;  // of all seats together: session_key() of each one's
  std::uint64_t strangers = 0;          // of all seats together: rows outside the parts of their seat
};

// The loads of all parts, if the record has the scale that is due. sizes: of the parts, or empty. Errors:
// invalid_argument (a part beyond the last, loads that no weights have).
Result<partition::LoadSummary> loads_of(const CountRecord& record, int parts, std::span<const double> sizes);

// Whether the n particles of a step are those that the scene had, but for what came and went. Errors: not_conserved.
Status check_conserved(const std::string& scene, std::uint64_t had, std::uint64_t n, std::uint64_t inserted,
                       std::uint64_t removed);

// Whether these are loads in a scale: of 127 bits, all together.
bool sum_fits(std::span<const u128> loads);
// The scale that the weights of n particles need; nothing where weights don't count, since all are equal.
std::optional<int> scale_due(const WeightCount& weights, std::uint64_t n);

}  // namespace rcb::scene
