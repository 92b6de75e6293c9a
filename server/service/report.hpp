// StepReport: what a committed step did, and its JSON form (the fields are promised to users).
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "common/wire/message.hpp"

namespace rcb::service {

struct StepSeconds {
  double receive = 0;   // from the first byte to all ranks holding their slices
  double exchange = 0;  // particles that drifted to another rank's parts
  double search = 0;    // cuts
  double migrate = 0;   // particles whose rank the new cuts changed
  double total = 0;

  StepSeconds& operator+=(const StepSeconds& other);
};

// What a step did not have to do; reports name them in this order.
enum class Skip : std::uint8_t {
  dimension,
  weights,
  ids,
  double_precision,
  motion,
  exchange,
  search,
  far_from_cuts,
};

class Skips {
 public:
  void add(Skip skip) { bits_ |= static_cast<std::uint8_t>(1U << static_cast<unsigned>(skip)); }
  std::vector<std::string> names() const;

 private:
  std::uint8_t bits_ = 0;
};

// Many are kept (history.hpp), so they hold no more than they must.
struct StepReport {
  std::string scene;
  std::int64_t step = 0;
  std::uint64_t epoch = 0;
  std::uint64_t n = 0;
  int parts = 1;
  bool scene_recreated = false;  // the first step of a scene that its client made anew after a loss
  std::optional<double> error_before;
  double error = 0;
  double imbalance = 1;
  bool repartitioned = false;
  std::string reason;
  int axes_flipped = 0;
  std::uint64_t drifted = 0;
  std::uint64_t moved = 0;
  std::uint64_t migrated = 0;
  std::uint64_t inserted = 0;
  std::uint64_t removed = 0;
  std::optional<std::int64_t> first_id;  // of the inserted, where the service chose their ids
  std::uint64_t scanned = 0;             // particles whose positions came and were looked at
  std::uint64_t searched = 0;            // particles that a search for cuts looked at
  std::uint64_t rounds = 0;              // of the search for cuts; 0: none
  std::uint64_t reductions = 0;          // its collectives
  Skips skipped;
  std::uint64_t bytes = 0;  // received
  StepSeconds seconds;
};

wire::Json to_json(const StepSeconds& seconds);
wire::Json to_json(const StepReport& report);

}  // namespace rcb::service
