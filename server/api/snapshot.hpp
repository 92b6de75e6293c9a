// Snapshot: the summary of each scene that the I/O thread can read while the engine is busy. Every answer of the engine
// brings the summary of the one scene that its order may have changed, so the cost of an order doesn't depend on the
// number of scenes.
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
  bool ids = false;  // ids aren't 0..n-1
  std::optional<std::int64_t> step;
  std::uint64_t steps = 0;  // committed
  std::uint64_t epoch = 0;
  std::optional<double> error;  // these three are set after the first push
  std::optional<double> imbalance;
  std::optional<double> mean_step_seconds;
  std::uint64_t plan_version = 0;
  std::uint64_t plan_checksum = 0;
  std::vector<std::uint64_t> rank_counts;  // particles on each rank
};

using Snapshot = std::map<std::string, SceneSummary>;  // by name

// The state of a scene after an order; no summary if the scene doesn't exist (any more).
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
