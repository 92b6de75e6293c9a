// One pass of the service along a trajectory, and what it did.
#pragma once

#include <array>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "client/lib/client.hpp"
#include "common/base/status.hpp"
#include "tests/bench/dynamic/dynamic_trajectory.hpp"
#include "tests/bench/step/floor.hpp"

namespace rcb::bench {

struct DynamicSetting {
  std::string positions = "every-step";  // or "when-needed"
  bool cost = false;                     // the policy cost; else by tolerance
  double tolerance = 0;                  // may be infinity
  double axis_hysteresis = 1.2;
};

// Times of a step: seconds, search, migrate, exchange, client, round_trip as below.
using StepTimes = std::array<double, 6>;

// Over all steps but the first.
struct DynamicRun {
  std::vector<StepTimes> steps;
  double seconds = 0;             // in service, as the reports say
  double seconds_search = 0;      // of these
  double seconds_migrate = 0;     // particles that new cuts sent to another rank
  double seconds_exchange = 0;    // particles that drifted to another rank
  double seconds_client = 0;      // waiting for the answers, the client library's own work included
  double seconds_round_trip = 0;  // bare round trips, one after each step
  double seconds_first = 0;       // in service for the first push
  double seconds_lost = 0;        // what a solver with a process a part would wait for its most loaded one
  std::uint64_t repartitions = 0;
  std::uint64_t sent = 0;  // steps in which positions travelled
  std::uint64_t drifted = 0;
  std::uint64_t moved = 0;
  std::uint64_t migrated = 0;
  double arrival_mean = 0, arrival_max = 0;  // error found when a step's positions arrived
  double error_mean = 0, error_max = 0;      // error that stood after a step

  void add(const StepTimes& times);  // to the sums and to `steps`
  // The sums become those of each step's median over these runs, which did the same: a disturbance of one step of one
  // run counts in nothing.
  void take_medians(std::span<const DynamicRun> runs);
};

// Each push tells as the solver's time what a solver with a process a part and this speed would have needed: the
// recorded seconds over the number of parts, times the imbalance that the last step left.
// After each step a bare message as long as the last count, before any as long as one may be, is sent and answered by
// as many bytes as the report has. Errors: the client's; those of reading the trajectory; aborted where `interrupted`
// says so.
Result<DynamicRun> replay(client::Client& client, RoundTrip& round_trip, const Trajectory& trajectory, int parts,
                          const DynamicSetting& setting, const std::function<bool()>& interrupted);

}  // namespace rcb::bench
