// From a frame of a file to a step: frames with ids may list their particles in any order, and particles may come and
// go from one to the next.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "client/cli/files/point_file.hpp"
#include "client/lib/client.hpp"
#include "common/io/points.hpp"

namespace rcb::cli {

// Positions that float32 represents exactly are sent as float32: half the bytes, the same values.
class CompactPositions {
 public:
  explicit CompactPositions(const io::Points& points) : points_(points) {
    for (const auto& axis : points.position)
      for (const double value : axis)
        if (static_cast<double>(static_cast<float>(value)) != value) return;
    for (const auto& axis : points.position) single_.emplace_back(axis.begin(), axis.end());
  }
  client::Positions positions() const {
    if (single_.empty()) return positions_of(points_);
    std::vector<const float*> axes;
    for (const auto& axis : single_) axes.push_back(axis.data());
    return client::Positions::axes(axes, points_.count);
  }

 private:
  const io::Points& points_;
  std::vector<std::vector<float>> single_;
};

// Such a push would make a scene without particles, which is hardly meant.
Status no_points(const std::string& file, const std::string& scene);
// A solver that has the scene open numbers its steps by itself: if others pushed, its next one would be refused
// (stale_step), and the solver would end. shown: the answer to scene.show.
Status check_not_held(const Json& shown, const std::string& scene, const std::string& hint);

class FramePusher {
 public:
  // ids: of the particles that the scene has, ascending.
  FramePusher(client::Scene scene, std::vector<std::int64_t> ids) : scene_(std::move(scene)), ids_(std::move(ids)) {}

  // Says to the service how many particles came and went, as the ids tell. Errors: the service's; invalid_argument, if
  // particles came or went, and there are no ids.
  Result<client::StepResult> push(const io::Points& frame, client::StepOptions step);
  std::optional<std::int64_t> last_step() const { return scene_.last_step(); }

 private:
  client::Scene scene_;
  std::vector<std::int64_t> ids_;  // ascending; the rows' numbers, if the solver gives none
};

}  // namespace rcb::cli
