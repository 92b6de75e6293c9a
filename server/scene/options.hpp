// Room `scene`: rank 0's scene, without its particles: options, steps, loads, the policy, the history. A pure state
// machine: it knows neither MPI nor sockets, threads or clocks.
//
// SceneOptions: what a scene was created with.
#pragma once

#include <optional>
#include <string_view>
#include <vector>

#include "common/base/status.hpp"
#include "common/cuts/cut_tree.hpp"
#include "common/wire/message.hpp"

namespace rcb::scene {

// When new cuts are searched (policy.hpp).
enum class Policy { tolerance, cost };

std::string_view policy_name(Policy policy);
std::optional<Policy> policy_from_name(std::string_view name);

// Which positions the ranks hold: those of every step, or those of the last step that had to send them.
enum class Travel { every_step, when_needed };

std::string_view travel_name(Travel travel);
std::optional<Travel> travel_from_name(std::string_view name);

struct SceneOptions {
  int parts = 1;
  int dims = 3;
  cuts::Method method = cuts::Method::rcb;
  double tolerance = 0.1;  // may be infinity
  double axis_hysteresis = 1.2;
  double cut_tolerance = 0;  // for every search; 0: exact cuts
  Policy policy = Policy::tolerance;
  Travel positions = Travel::every_step;
  std::vector<double> part_sizes;
};

// As scene.create takes them, but for part_sizes, which may be many; and back. Errors: invalid_argument.
wire::Json to_json(const SceneOptions& options);
Result<SceneOptions> read_options(const wire::Json& request);
// The field "method", or `otherwise` if absent; must suit `dims`. Errors: invalid_argument.
Result<cuts::Method> read_method(const wire::Json& request, int dims, cuts::Method otherwise);

}  // namespace rcb::scene
