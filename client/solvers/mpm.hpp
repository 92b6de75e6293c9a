// The material point method, explicit: points carry mass, velocity, deformation; a background grid, new every
// substep, carries momentum between them.
//
// Transfers are MLS-MPM with quadratic B-splines and an affine velocity a point (APIC).
// Sources: Sulsky, Chen, Schreyer 1994, doi:10.1016/0045-7825(94)90112-0 (the method); Jiang et al. 2015,
// doi:10.1145/2766996 (affine transfers); Hu et al. 2018, doi:10.1145/3197517.3201293 (stress through them).
//
// 1. One thread, one order of summation: the same start gives the same bits.
// 2. Momentum changes only by gravity and by the boundaries, and both are added up in impulse().
// 3. No substep is longer than cfl * spacing / (wave speed + point speed), both taken anew before each.
// 4. Points stay in the domain: its walls are smooth (nothing passes them, they don't hold anything back), and a
//    point found outside all the same ends the run.
// 5. A substep falls into parts, so that several of these, each with some of the points, can share one grid: between
//    particles_to_grid() and update_grid() somebody may add up their grids.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <memory>
#include <span>
#include <vector>

#include "client/solvers/mat3.hpp"
#include "client/solvers/material.hpp"
#include "client/solvers/sampling.hpp"
#include "common/base/status.hpp"

namespace rcb::solvers {

// Solid ground: every grid node with normal . (x - point) <= 0 is held. Nothing moves into it; motion along it is held
// back by at most `friction` times what was taken from the motion into it (Coulomb); motion out of it is free.
struct Ground {
  static constexpr double kSticky = std::numeric_limits<double>::infinity();  // no motion at all, none out of it either

  Vec3 point{};
  Vec3 normal{};  // of length 1, out of the ground
  double friction = kSticky;
};

struct Node {
  alignas(32) std::array<double, 4> value;  // momentum, after update_grid() velocity, of x, y, z; mass
};

// The grid nodes first[a] <= k < last[a] on each axis.
struct NodeBox {
  std::array<std::size_t, 3> first{};
  std::array<std::size_t, 3> last{};
};

struct MpmOptions {
  Vec3 lo{};  // the domain
  Vec3 hi{};
  double spacing = 0;  // of the grid
  double cfl = 0.4;    // (0, 1)
  std::vector<Ground> ground;
};

// Quadratic B-spline: weights of the three nodes from the base node on. offset: from the base node to the point, in
// spacings, 0.5 <= offset < 1.5. They sum to 1, and weighted with the nodes' places they give the point's.
inline std::array<double, 3> spline_weights(double offset) {
  const double low = 1.5 - offset;
  const double middle = offset - 1;
  const double high = offset - 0.5;
  return {0.5 * low * low, 0.75 - middle * middle, 0.5 * high * high};
}

// Sums over all points. `potential` is 0 where the points were put.
struct Balance {
  Vec3 momentum{};
  Vec3 angular{};        // momentum about the origin, the affine part included
  double speed_sum = 0;  // sum of mass times speed: what a drift of momentum is measured against
  double kinetic = 0;    // the affine part included
  double elastic = 0;
  double potential = 0;  // minus the work of gravity so far
  double energy() const { return kinetic + elastic + potential; }
};

// Everything that a point is; may be copied as bytes.
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

// The cores that hold the other points of the same bodies, each a process or a thread. All call the same in the same
// order.
class OtherCores {
 public:
  virtual ~OtherCores() = default;
  // The fastest signal of all cores: their largest wave_speed() and their largest point_speed(), added. `mine`: what
  // update_stress() said here. A failure of one is everybody's.
  virtual Result<double> fastest(const Mpm& mpm, const Result<double>& mine) = 0;
  // Sums momentum and mass, node by node, wherever another core's touched() box reaches too.
  virtual void sum_grid(Mpm& mpm) = 0;
  // The first failure of all cores, on every one.
  virtual Status agree(const Status& mine) = 0;
};

class Mpm {
 public:
  // Errors: kInvalidArgument (domain, spacing, cfl), kTooLarge (more grid nodes than kNodesMax).
  static Result<Mpm> create(const MpmOptions& options);

  static constexpr std::uint64_t kNodesMax = 100'000'000;
  static constexpr std::uint64_t kSubstepsMax = 10'000;  // in one advance()

  // Points of one material, undeformed, numbered on from those there are. volume: of all of them together, > 0.
  // gravity: what acts on them (reduced where water carries part of the weight).
  Status add_body(std::shared_ptr<const Material> material, const Cloud& cloud, double volume, const Vec3& velocity,
                  const Vec3& gravity);

  // Moves everything on by `seconds` > 0, in as many substeps as invariant 3 asks.
  // Errors: a point left the domain or turned inside out, or kSubstepsMax would be passed; the state is then of no use.
  // others: who holds the rest of the points; null: this one holds all. Every core advances by the same.
  Status advance(double seconds, OtherCores* others = nullptr);

  // The parts of a substep, in this order; advance() is nothing but these. Several cores that together hold one body
  // take the largest of their wave and point speeds, one dt, and between the second and the third part sum values node
  // by node within their touched() boxes. Physics is then that of one core but for rounding; impulse() counts gravity
  // on this core's points only, but the boundaries' share on all nodes that it touched.
  Result<double> update_stress();                    // the fastest signal, m/s; errors: a point turned inside out
  double wave_speed() const { return wave_speed_; }  // the two that it is made of
  double point_speed() const { return speed_max_; }
  double dt_max(double signal_speed) const { return cfl_ * spacing_ / signal_speed; }
  void particles_to_grid(double dt);
  void update_grid();
  Status grid_to_particles(double dt);  // errors: a point left the domain

  // The grid: node (i, j, k) lies at grid_origin() + (i, j, k) * spacing(), and is number
  // (i * grid_nodes()[1] + j) * grid_nodes()[2] + k. Of meaning only within touched(), where points reach; 0 elsewhere.
  std::span<Node> grid() { return grid_; }
  const std::array<std::size_t, 3>& grid_nodes() const { return nodes_; }
  const Vec3& grid_origin() const { return origin_; }
  const NodeBox& touched() const { return touched_; }

  // Points go to other cores and come from them. leaving: their places here, ascending. Afterwards the points of each
  // body are in ascending id. Balances of all cores still add up.
  PointState point(std::size_t p) const;
  void exchange(std::span<const std::size_t> leaving, std::span<const PointState> arriving);
  std::span<const std::int64_t> id() const { return id_; }  // [size]; numbered on from 0 by add_body()

  std::size_t size() const { return position_[0].size(); }
  std::span<const double> position(std::size_t axis) const { return position_[axis]; }  // [size]
  std::span<const double> velocity(std::size_t axis) const { return velocity_[axis]; }  // [size]
  double time() const { return time_; }
  std::uint64_t substeps() const { return substeps_; }  // since the start
  const Vec3& impulse() const { return impulse_; }      // of gravity and boundaries, since the start
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
  Vec3 origin_{};                       // the first node
  std::array<std::size_t, 3> nodes_{};  // an axis; the last axis is contiguous
  std::vector<Node> grid_;
  NodeBox touched_;

  std::vector<Body> bodies_;
  std::vector<std::int64_t> id_;
  std::array<std::vector<double>, 3> position_;
  std::array<std::vector<double>, 3> velocity_;
  std::vector<Mat3> affine_;
  std::vector<Mat3> deformation_;
  std::vector<double> memory_;  // of the laws
  std::vector<Mat3> stress_;    // Kirchhoff
  double wave_speed_ = 0;
  double speed_max_ = 0;
  double potential_start_ = 0;
  double time_ = 0;
  std::uint64_t substeps_ = 0;
  Vec3 impulse_{};
};

}  // namespace rcb::solvers
