// CountRecord: what a solver counted by the cuts it knows, in place of the positions of a step.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "common/base/wide.hpp"
#include "common/partition/balance/load.hpp"
#include "common/wire/message.hpp"

namespace rcb::scene {

// XXH3-64 of a session's name, which takes less memory than the text.
std::uint64_t session_key(const std::string& session);

struct WeightCount {
  int scale = 0;  // a load is the sum of weights, each times 2^scale, rounded down
  double least = 0;
  double greatest = 0;
  std::uint64_t as_zero = 0;  // weights above 0 that count as 0 in this scale
  std::vector<u128> loads;    // by entry of CountRecord::parts; any bits where another scale is due
};

struct CountRecord {
  std::string session;
  std::int64_t step = 0;
  std::uint64_t incarnation = 0;
  std::uint64_t epoch = 0;  // of the cuts that it counted by
  std::uint64_t hash = 0;
  std::uint64_t n = 0;
  std::uint64_t inserted = 0;            // particles that were not there at the step before
  std::uint64_t removed = 0;             // particles of the step before that are no more
  std::optional<std::uint64_t> id_sum;   // of mix64(id), mod 2^64; none: rows are ids
  std::optional<std::uint64_t> drifted;  // rows whose part is another than at the step before
  std::optional<double> step_seconds;    // the solver's computing time since its last step
  std::vector<std::int32_t> parts;       // that have particles, ascending
  std::vector<std::uint64_t> counts;     // of these
  std::optional<WeightCount> weights;
  std::uint64_t bytes = 0;              // of its frame
  std::vector<std::uint64_t> sessions;  // of all seats together: the key of each one's
  std::uint64_t strangers = 0;          // of all seats together: rows outside the parts of their seat

  bool flows() const { return inserted > 0 || removed > 0; }
};

// The JSON of a request `count` and its arrays. Errors: invalid_argument, whatever is wrong with the record by itself.
Result<CountRecord> read_count(const wire::Json& request, const std::vector<wire::Array>& arrays);

// The loads of all parts, if the record has the scale that is due. sizes: of the parts, or empty. Errors:
// invalid_argument (a part beyond the last, loads that no weights have).
Result<partition::LoadSummary> loads_of(const CountRecord& record, int parts, std::span<const double> sizes);

// Whether the n particles of a step are those that the scene had, but for what came and went. Errors: not_conserved.
Status check_conserved(const std::string& scene, std::uint64_t had, std::uint64_t n, std::uint64_t inserted,
                       std::uint64_t removed);

inline constexpr int kScaleMost = 1300;  // either way; of the smallest double there is
// Whether these are loads in a scale: of 127 bits, all together.
bool sum_fits(std::span<const u128> loads);
// The scale that the weights of n particles need; nothing where weights don't count, since all are equal.
std::optional<int> scale_due(const WeightCount& weights, std::uint64_t n);

}  // namespace rcb::scene
