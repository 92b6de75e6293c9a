// Mpm: points sent to and received from other cores.
#include <algorithm>
#include <type_traits>
#include <vector>

#include "client/solvers/mpm/mpm.hpp"
#include "common/base/check.hpp"

namespace rcb::solvers {

static_assert(std::is_trivially_copyable_v<PointState>);

std::size_t Mpm::body_of(std::size_t p) const {
  std::size_t body = 0;
  while (p >= bodies_[body].first + bodies_[body].count) ++body;
  return body;
}

PointState Mpm::point(std::size_t p) const {
  PointState state;
  state.id = id_[p];
  state.body = body_of(p);
  for (std::size_t a = 0; a < 3; ++a) {
    state.position[a] = position_[a][p];
    state.velocity[a] = velocity_[a][p];
  }
  state.affine = affine_[p];
  state.deformation = deformation_[p];
  state.memory = memory_[p];
  return state;
}

void Mpm::put(std::size_t p, const PointState& state) {
  id_[p] = state.id;
  for (std::size_t a = 0; a < 3; ++a) {
    position_[a][p] = state.position[a];
    velocity_[a][p] = state.velocity[a];
  }
  affine_[p] = state.affine;
  deformation_[p] = state.deformation;
  memory_[p] = state.memory;
}

void Mpm::exchange(std::span<const std::size_t> leaving, std::span<const PointState> arriving) {
  if (leaving.empty() && arriving.empty()) return;
  std::vector<std::vector<PointState>> of(bodies_.size());
  std::size_t next = 0;
  std::size_t total = 0;
  // The potential is relative to where points were put, so a point takes its share of potential_start_ with it.
  const auto potential = [this](const PointState& state) {
    const Body& body = bodies_[state.body];
    return -body.mass * dot(body.gravity, state.position);
  };
  for (std::size_t p = 0; p < size(); ++p) {
    const PointState state = point(p);
    if (next < leaving.size() && leaving[next] == p) {
      ++next;
      potential_start_ -= potential(state);
    } else {
      of[state.body].push_back(state);
    }
  }
  RCB_CHECK(next == leaving.size(), "places in ascending order");
  for (const PointState& state : arriving) {
    RCB_CHECK(state.body < bodies_.size(), "a point of a body that this core knows");
    potential_start_ += potential(state);
    of[state.body].push_back(state);
  }
  for (const auto& points : of) total += points.size();
  id_.resize(total);
  for (std::size_t a = 0; a < 3; ++a) {
    position_[a].resize(total);
    velocity_[a].resize(total);
  }
  affine_.resize(total);
  deformation_.resize(total);
  memory_.resize(total);
  std::size_t at = 0;
  for (std::size_t b = 0; b < bodies_.size(); ++b) {
    std::sort(of[b].begin(), of[b].end(), [](const PointState& x, const PointState& y) { return x.id < y.id; });
    bodies_[b].first = at;
    bodies_[b].count = of[b].size();
    for (const PointState& state : of[b]) put(at++, state);
  }
}

}  // namespace rcb::solvers
