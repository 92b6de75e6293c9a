// StepReport: what a committed step did, and its JSON form (its fields are part of the protocol).
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "common/wire/message.hpp"

namespace rcb::scene {

// How what a step needs came to the service: as counts alone, or how the positions came to the ranks.
enum class Way : std::uint8_t { endpoint, sockets, shared_memory, file, count };
const char* name_of(Way way);

struct StepSeconds {
  double receive = 0;   // from the first byte until all ranks hold their slices
  double exchange = 0;  // migration in a step without new cuts
  double search = 0;    // search for cuts
  double migrate = 0;   // migration in a step with new cuts, of drifted particles too
  double total = 0;

  StepSeconds& operator+=(const StepSeconds& other);
};

// Work that a step could skip; reports list the names in this order.
enum class Skip : std::uint8_t {
  dimension,
  weights,
  ids,
  double_precision,
  exchange,
  search,
  far_from_cuts,
  positions,
};

class Skips {
 public:
  void add(Skip skip) { bits_ |= static_cast<std::uint16_t>(1U << static_cast<unsigned>(skip)); }
  std::vector<std::string> names() const;

 private:
  std::uint16_t bits_ = 0;
};

// What a step did, in numbers; also the sums over all steps of a scene.
struct StepCounts {
  std::uint64_t bytes = 0;       // of arrays, as received
  std::uint64_t drifted = 0;     // particles that moved across a cut into another part
  std::uint64_t moved = 0;       // particles whose part new cuts changed
  std::uint64_t migrated = 0;    // particles that changed rank; 0 at the first push
  std::uint64_t scanned = 0;     // particles whose positions were received and scanned
  std::uint64_t searched = 0;    // particles in the search for cuts
  std::uint64_t rounds = 0;      // of the search for cuts; 0: no search
  std::uint64_t reductions = 0;  // collectives of the search
  StepSeconds seconds;

  StepCounts& operator+=(const StepCounts& other);
};

// Kept small, since many are kept in memory (history.hpp).
struct StepReport : StepCounts {
  std::string scene;
  std::int64_t step = 0;
  std::uint64_t epoch = 0;
  std::uint64_t n = 0;
  int parts = 1;
  std::optional<double> error_before;
  double error = 0;
  double imbalance = 1;
  bool repartitioned = false;
  std::string reason;
  int axes_flipped = 0;
  std::uint64_t inserted = 0;
  std::uint64_t removed = 0;
  std::uint64_t weights_as_zero = 0;  // particles whose weight is too far below the greatest one to count
  Skips skipped;
  Way way = Way::endpoint;
  std::optional<std::int64_t> positions_step;  // the step whose positions the ranks hold; none: they hold none
  bool drifted_known = true;                   // false: nobody has compared with the step before
  std::uint64_t strangers = 0;                 // rows outside their seat's parts as the step arrived

  bool sent() const { return way != Way::count; }  // positions travelled
};

// The counts alone.
wire::Json to_json(const StepCounts& counts);
std::string text_of(const StepReport& report);  // as JSON
wire::Json to_json(const StepReport& report);

}  // namespace rcb::scene
