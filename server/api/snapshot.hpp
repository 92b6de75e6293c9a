// What the I/O thread may know of the scenes while the engine is busy: a summary of each. Every answer of the engine
// brings that of the one scene that its order may have changed, so an order costs the same however many scenes there
// are.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace rcb::api {

struct SceneSummary {
  std::uint64_t n = 0;
  int dims = 3;
  int parts = 1;
  bool weights = false;
  std::optional<std::int64_t> step;
  std::uint64_t steps = 0;  // committed
  std::uint64_t epoch = 0;
  std::optional<double> error;  // these three: once it was pushed
  std::optional<double> imbalance;
  std::optional<double> mean_step_seconds;
  std::uint64_t plan_version = 0;
  std::uint64_t plan_checksum = 0;
  std::vector<std::uint64_t> rank_counts;  // particles that each rank holds
};

using Snapshot = std::map<std::string, SceneSummary>;  // by name

// What an order has made of its scene; no summary: there is none of that name.
struct SceneChange {
  std::string scene;
  std::optional<SceneSummary> summary;
};

inline void apply(SceneChange change, Snapshot& snapshot) {
  if (change.summary)
    snapshot.insert_or_assign(std::move(change.scene), *std::move(change.summary));
  else
    snapshot.erase(change.scene);
}

}  // namespace rcb::api
