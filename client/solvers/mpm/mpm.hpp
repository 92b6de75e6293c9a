// Room `mpm`: the method itself, independent of the service: points, materials, grid.
//
// The explicit material point method: points carry mass, velocity and deformation; a background grid, reset every
// substep, carries momentum between them.
//
// Transfers are MLS-MPM with quadratic B-splines and an affine velocity field for each point (APIC). Sources: Sulsky,
// Chen, Schreyer 1994, doi:10.1016/0045-7825(94)90112-0 (the method); Jiang et al. 2015, doi:10.1145/2766996 (affine
// transfers); Hu et al. 2018, doi:10.1145/3197517.3201293 (stress in these transfers).
//
// 1. One thread and a fixed order of summation: the same start gives the same bits.
// 2. Momentum changes only by gravity and boundaries; impulse() has the sum of both.
// 3. No substep is longer than cfl * spacing / (wave speed + point speed), both computed before each substep.
// 4. Points stay in the domain: its walls are smooth (impenetrable, frictionless, not adhesive), and a point found
//    outside nevertheless ends the run.
// 5. A substep consists of stages, so that several Mpm objects, each with some of the points, can share one grid:
//    between particles_to_grid() and update_grid() the caller may sum their grids.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <memory>
#include <span>
#include <vector>

#include "client/solvers/mpm/mat3.hpp"
#include "client/solvers/mpm/material.hpp"
#include "client/solvers/mpm/sampling.hpp"
#include "common/base/status.hpp"

namespace rcb::solvers {

// Solid ground, for every grid node with normal . (x - point) <= 0. Velocity into it is removed; velocity along it is
// reduced by at most `friction` times the removed velocity (Coulomb); velocity out of it is free.
struct Ground {
  static constexpr double kSticky = std::numeric_limits<double>::infinity();  // no motion at all, not even out of it

  Vec3 point{};
  Vec3 normal{};  // unit vector out of the ground
  double friction = kSticky;
};

struct Node {
  alignas(32) std::array<double, 4> value;  // x, y, z of momentum (velocity after update_grid()); mass
};

// The grid nodes first[a] <= k < last[a] on each axis.
struct NodeBox {
  std::array<std::size_t, 3> first{};
  std::array<std::size_t, 3> last{};
};

struct MpmOptions {
  Vec3 lo{};  // bounds of the domain
  Vec3 hi{};
  double spacing = 0;  // of the grid
  double cfl = 0.4;    // (0, 1)
  std::vector<Ground> ground;
};

// Quadratic B-spline: the weights of three nodes, from the base node on. offset: from the base node to the point, in
// spacings, 0.5 <= offset < 1.5. The weights sum to 1, and the weighted mean of the nodes' positions is the point's.
inline std::array<double, 3> spline_weights(double offset) {
  const double low = 1.5 - offset;
  const double middle = offset - 1;
  const double high = offset - 0.5;
  return {0.5 * low * low, 0.75 - middle * middle, 0.5 * high * high};
}

// Sums over all points. `potential` is relative to the points' initial positions.
struct Balance {
  Vec3 momentum{};
  Vec3 angular{};        // about the origin, including the affine part
  double speed_sum = 0;  // sum of mass times speed, the scale for a drift of momentum
  double kinetic = 0;    // including the affine part
  double elastic = 0;
  double potential = 0;  // minus the work done by gravity
  double energy() const { return kinetic + elastic + potential; }
};

// The complete state of a point; trivially copyable.
struct PointState {
  std::int64_t id = 0;
  std::uint64_t body = 0;  // in the order of add_body()
  Vec3 position{};
  Vec3 velocity{};
  Mat3 affine;
  Mat3 deformation;
  double memory = 0;
};

class Mpm;

// The other cores (processes or threads), which hold the other points of the same bodies. Every method is collective.
class OtherCores {
 public:
  virtual ~OtherCores() = default;
  // The signal speed for all cores: the sum of their largest wave_speed() and their largest point_speed(). `mine`: the
  // result of update_stress() here. If it failed on any core, all return that failure.
  virtual Result<double> signal_speed(const Mpm& mpm, const Result<double>& mine) = 0;
  // Sums momentum and mass at the nodes that lie in the touched() boxes of several cores.
  virtual void sum_grid(Mpm& mpm) = 0;
  // Returns on every core the failure of the first core that has one.
  virtual Status agree(const Status& mine) = 0;
};

class Mpm {
 public:
  // Errors: invalid_argument (domain, spacing, cfl), too_large (more grid nodes than kNodesMax).
  static Result<Mpm> create(const MpmOptions& options);

  static constexpr std::uint64_t kNodesMax = 100'000'000;
  static constexpr std::uint64_t kSubstepsMax = 10'000;  // in one advance()

  // Adds undeformed points of one material, with the next free ids. volume: of all these points together, > 0. gravity:
  // the acceleration on them (reduced if water carries part of the weight).
  Status add_body(std::shared_ptr<const Material> material, const Cloud& cloud, double volume, const Vec3& velocity,
                  const Vec3& gravity);

  // Advances by `seconds` > 0, in as many substeps as invariant 3 needs. Errors: a point left the domain or was turned
  // inside out, or more than kSubstepsMax would be needed; the state is then unusable. others: the holders of the other
  // points; nullptr if there are none. All cores use the same substeps.
  Status advance(double seconds, OtherCores* others = nullptr);

  // The stages of a substep, in this order; advance() consists of these. Cores that share a body must use the same dt,
  // from the largest of their wave and point speeds, and between the second and the third stage sum the nodes in their
  // touched() boxes. The physics is then that of one core, except for rounding. impulse() counts gravity on this core's
  // points only, but the boundaries' part on all nodes that the core touched.
  Result<double> update_stress();                    // signal speed, m/s; errors: a point turned inside out
  double wave_speed() const { return wave_speed_; }  // the two addends of the signal speed
  double point_speed() const { return speed_max_; }
  double dt_max(double signal_speed) const { return cfl_ * spacing_ / signal_speed; }
  void particles_to_grid(double dt);
  void update_grid();
  Status grid_to_particles(double dt);  // errors: a point left the domain

  // The grid: node (i, j, k) lies at the origin + (i, j, k) * spacing(); k varies fastest, then j, in grid().
  // Values are meaningful only within touched(), and 0 elsewhere.
  std::span<Node> grid() { return grid_; }
  const std::array<std::size_t, 3>& grid_nodes() const { return nodes_; }
  const NodeBox& touched() const { return touched_; }

  // Removes the points sent to other cores and adds those received. leaving: indices here, ascending. Afterwards the
  // points of each body are in ascending id. The sum of all cores' balances is unchanged.
  PointState point(std::size_t p) const;
  void exchange(std::span<const std::size_t> leaving, std::span<const PointState> arriving);
  std::span<const std::int64_t> id() const { return id_; }  // [size]; numbered from 0 by add_body()

  std::size_t size() const { return position_[0].size(); }
  std::span<const double> position(std::size_t axis) const { return position_[axis]; }  // [size]
  std::span<const double> velocity(std::size_t axis) const { return velocity_[axis]; }  // [size]
  double time() const { return time_; }
  std::uint64_t substeps() const { return substeps_; }  // since the start
  const Vec3& impulse() const { return impulse_; }      // from gravity and boundaries, since the start
  double spacing() const { return spacing_; }
  Balance balance() const;

 private:
  struct Body {
    std::shared_ptr<const Material> material;
    std::size_t first;
    std::size_t count;
    double mass;    // of one point
    double volume;  // of one point, undeformed
    Vec3 gravity;
  };
  struct Stencil {
    std::size_t first;                            // the base node
    Vec3 offset;                                  // from the base node to the point, in spacings
    std::array<std::array<double, 3>, 3> weight;  // [axis][node]
  };

  explicit Mpm(const MpmOptions& options);
  Stencil stencil(std::size_t p) const;
  std::size_t body_of(std::size_t p) const;
  void put(std::size_t p, const PointState& state);
  void clear_grid();
  NodeBox reach() const;
  Vec3 held(const Vec3& x, Vec3 velocity) const;
  Status left_domain(std::size_t p) const;

  Vec3 lo_;
  Vec3 hi_;
  double spacing_;
  double cfl_;
  std::vector<Ground> ground_;
  Vec3 origin_{};                       // position of the first node
  std::array<std::size_t, 3> nodes_{};  // by axis; the last axis is contiguous
  std::vector<Node> grid_;
  NodeBox touched_;

  std::vector<Body> bodies_;
  std::vector<std::int64_t> id_;
  std::array<std::vector<double>, 3> position_;
  std::array<std::vector<double>, 3> velocity_;
  std::vector<Mat3> affine_;
  std::vector<Mat3> deformation_;
  std::vector<double> memory_;  // of the material laws
  std::vector<Mat3> stress_;    // Kirchhoff
  double wave_speed_ = 0;
  double speed_max_ = 0;
  double potential_start_ = 0;
  double time_ = 0;
  std::uint64_t substeps_ = 0;
  Vec3 impulse_{};
};

}  // namespace rcb::solvers
