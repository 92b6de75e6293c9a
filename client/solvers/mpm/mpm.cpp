#include "client/solvers/mpm/mpm.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <fmt/format.h>

#include "common/base/check.hpp"
#include "common/geometry/box.hpp"

namespace rcb::solvers {
namespace {

constexpr double kMarginNodes = 3;  // grid nodes outside the domain, so that a point at a wall has its whole stencil

double potential_of(const Vec3& gravity, double mass, const Vec3& x) { return -mass * dot(gravity, x); }

}  // namespace

Result<Mpm> Mpm::create(const MpmOptions& options) {
  if (!(options.spacing > 0) || !std::isfinite(options.spacing))
    return Status(Code::invalid_argument, fmt::format("the grid spacing is {}", options.spacing), "it must be above 0");
  if (!(options.cfl > 0 && options.cfl < 1))
    return Status(Code::invalid_argument, fmt::format("the CFL number is {}", options.cfl),
                  "it must lie between 0 and 1");
  double nodes = 1;
  for (std::size_t a = 0; a < 3; ++a) {
    const double length = options.hi[a] - options.lo[a];
    if (!(length > 0) || !std::isfinite(length))
      return Status(Code::invalid_argument,
                    fmt::format("the domain reaches from {} to {} on axis {}", options.lo[a], options.hi[a], a),
                    "its lower end must lie below its upper one");
    nodes *= std::ceil(length / options.spacing) + 2 * kMarginNodes + 1;
  }
  if (!(nodes <= static_cast<double>(kNodesMax)))
    return Status(Code::too_large, fmt::format("the grid would have {:.3g} nodes, the limit is {}", nodes, kNodesMax),
                  "use fewer points");
  return Mpm(options);
}

Mpm::Mpm(const MpmOptions& options)
    : lo_(options.lo), hi_(options.hi), spacing_(options.spacing), cfl_(options.cfl), ground_(options.ground) {
  // The domain is closed by smooth walls on all six sides.
  for (std::size_t a = 0; a < 3; ++a) {
    Vec3 inward{};
    inward[a] = 1;
    ground_.push_back({lo_, inward, 0});
    inward[a] = -1;
    ground_.push_back({hi_, inward, 0});
    origin_[a] = lo_[a] - kMarginNodes * spacing_;
    nodes_[a] = static_cast<std::size_t>(std::ceil((hi_[a] - lo_[a]) / spacing_) + 2 * kMarginNodes + 1);
  }
  grid_.resize(nodes_[0] * nodes_[1] * nodes_[2]);
}

Status Mpm::add_body(std::shared_ptr<const Material> material, const Cloud& cloud, double volume, const Vec3& velocity,
                     const Vec3& gravity) {
  const std::size_t first = size();
  const std::size_t count = cloud.size();
  if (count == 0) return {};
  RCB_CHECK(material != nullptr && volume > 0, "a body needs a material and a volume");
  for (std::size_t a = 0; a < 3; ++a)
    for (std::size_t p = 0; p < count; ++p)
      if (!(cloud.position[a][p] >= lo_[a] && cloud.position[a][p] <= hi_[a]))
        return Status(Code::invalid_argument,
                      fmt::format("point {} of a body lies at {} on axis {}, outside the domain {} .. {}", p,
                                  cloud.position[a][p], a, lo_[a], hi_[a]),
                      "put the body inside");
  const double volume_each = volume / static_cast<double>(count);
  const Body body{std::move(material), first, count, 0, volume_each, gravity};
  bodies_.push_back(body);
  bodies_.back().mass = volume_each * body.material->density();
  for (std::size_t a = 0; a < 3; ++a) {
    position_[a].insert(position_[a].end(), cloud.position[a].begin(), cloud.position[a].end());
    velocity_[a].resize(first + count, velocity[a]);
  }
  for (std::size_t p = first; p < first + count; ++p) id_.push_back(static_cast<std::int64_t>(p));
  affine_.resize(first + count);
  deformation_.resize(first + count, Mat3::identity());
  memory_.resize(first + count);
  speed_max_ = std::max(speed_max_, norm(velocity));
  for (std::size_t p = first; p < first + count; ++p)
    potential_start_ += potential_of(gravity, bodies_.back().mass, {position_[0][p], position_[1][p], position_[2][p]});
  return {};
}

Status Mpm::advance(double seconds, OtherCores* others) {
  RCB_CHECK(seconds > 0, "time goes on");
  const double end = time_ + seconds;
  double remaining = seconds;
  for (std::uint64_t done = 0; remaining > 0; ++done) {
    auto speed = update_stress();
    if (others != nullptr) speed = others->signal_speed(*this, speed);
    if (!speed) return speed.status();
    const double pieces = std::max(1.0, std::ceil(remaining / dt_max(*speed)));
    if (!(pieces + static_cast<double>(done) <= static_cast<double>(kSubstepsMax)))
      return Status(Code::too_large,
                    fmt::format("{:.3g} s of motion would need {:.3g} substeps at a signal speed of {:.3g} m/s and a "
                                "grid of {:.3g} m; the limit is {}",
                                seconds, pieces + static_cast<double>(done), *speed, spacing_, kSubstepsMax),
                    "shorten the interval, soften the material or use fewer points");
    const double dt = remaining / pieces;
    particles_to_grid(dt);
    if (others != nullptr) others->sum_grid(*this);
    update_grid();
    Status status = grid_to_particles(dt);
    if (others != nullptr) status = others->agree(status);
    if (!status.ok()) return status;
    remaining = pieces > 1 ? remaining - dt : 0;
    time_ = end - remaining;  // avoids the rounding errors of a sum
  }
  return {};
}

Mpm::Stencil Mpm::stencil(std::size_t p) const {
  Stencil result;
  std::size_t node = 0;
  for (std::size_t a = 0; a < 3; ++a) {
    const double at = (position_[a][p] - origin_[a]) / spacing_;
    const auto base = static_cast<std::size_t>(at - 0.5);  // never negative: points stay away from the margin
    result.offset[a] = at - static_cast<double>(base);
    result.weight[a] = spline_weights(result.offset[a]);
    node = node * nodes_[a] + base;
  }
  result.first = node;
  return result;
}

Result<double> Mpm::update_stress() {
  stress_.resize(size());
  double wave_speed = 0;
  for (const Body& body : bodies_) {
    const StressPass pass = body.material->update(std::span(deformation_).subspan(body.first, body.count),
                                                  std::span(memory_).subspan(body.first, body.count),
                                                  std::span(stress_).subspan(body.first, body.count));
    if (pass.broken != StressPass::kNone)
      return Status(Code::invalid_argument,
                    fmt::format("point {} was turned inside out at t = {:.6g} s", body.first + pass.broken, time_),
                    "the load is too much for this material: a lower speed, a stiffer material or more points help");
    wave_speed = std::max(wave_speed, pass.wave_speed_max);
  }
  wave_speed_ = wave_speed;
  return wave_speed + speed_max_;
}

// The box of all nodes in any point's stencil.
NodeBox Mpm::reach() const {
  NodeBox box;
  if (size() == 0) return box;
  for (std::size_t a = 0; a < 3; ++a) {
    double low = position_[a][0];
    double high = low;
    geometry::least_and_most(position_[a], low, high);
    box.first[a] = static_cast<std::size_t>((low - origin_[a]) / spacing_ - 0.5);
    box.last[a] = static_cast<std::size_t>((high - origin_[a]) / spacing_ - 0.5) + 3;
  }
  return box;
}

void Mpm::clear_grid() {
  const NodeBox& box = touched_;
  for (std::size_t i = box.first[0]; i < box.last[0]; ++i)
    for (std::size_t j = box.first[1]; j < box.last[1]; ++j) {
      Node* row = &grid_[(i * nodes_[1] + j) * nodes_[2]];
      std::fill(row + box.first[2], row + box.last[2], Node{});
    }
}

void Mpm::particles_to_grid(double dt) {
  clear_grid();
  touched_ = reach();
  const std::size_t row = nodes_[2];
  const std::size_t plane = nodes_[1] * nodes_[2];
  for (const Body& body : bodies_) {
    const double stress_scale = -dt * body.volume * 4 / (spacing_ * spacing_);
    for (std::size_t p = body.first; p < body.first + body.count; ++p) {
      const Stencil s = stencil(p);
      // The momentum that a node at distance d (in spacings) gets before weighting: the point's momentum + slope d.
      Mat3 slope;
      for (std::size_t k = 0; k < 9; ++k)
        slope.e[k] = (body.mass * affine_[p].e[k] + stress_scale * stress_[p].e[k]) * spacing_;
      Vec3 at_base;
      for (std::size_t i = 0; i < 3; ++i)
        at_base[i] = body.mass * (velocity_[i][p] + dt * body.gravity[i]) - slope(i, 0) * s.offset[0] -
                     slope(i, 1) * s.offset[1] - slope(i, 2) * s.offset[2];
      for (std::size_t i = 0; i < 3; ++i)
        for (std::size_t j = 0; j < 3; ++j) {
          Node* node = &grid_[s.first + i * plane + j * row];
          const double weight_ij = s.weight[0][i] * s.weight[1][j];
          const double di = static_cast<double>(i);
          const double dj = static_cast<double>(j);
          double x = at_base[0] + slope(0, 0) * di + slope(0, 1) * dj;
          double y = at_base[1] + slope(1, 0) * di + slope(1, 1) * dj;
          double z = at_base[2] + slope(2, 0) * di + slope(2, 1) * dj;
          for (std::size_t k = 0; k < 3; ++k, ++node) {
            const double weight = weight_ij * s.weight[2][k];
            node->value[0] += weight * x;
            node->value[1] += weight * y;
            node->value[2] += weight * z;
            node->value[3] += weight * body.mass;
            x += slope(0, 2);
            y += slope(1, 2);
            z += slope(2, 2);
          }
        }
    }
    for (std::size_t a = 0; a < 3; ++a)
      impulse_[a] += dt * body.mass * static_cast<double>(body.count) * body.gravity[a];
  }
}

Vec3 Mpm::held(const Vec3& x, Vec3 velocity) const {
  for (const Ground& ground : ground_) {
    if (dot(ground.normal, x - ground.point) > 0) continue;
    if (ground.friction == Ground::kSticky) return {};
    const double inward = dot(ground.normal, velocity);
    if (inward >= 0) continue;
    velocity = velocity - inward * ground.normal;
    if (ground.friction == 0) continue;
    const double along = norm(velocity);
    const double taken = -inward * ground.friction;
    velocity = taken < along ? (1 - taken / along) * velocity : Vec3{};
  }
  return velocity;
}

void Mpm::update_grid() {
  const NodeBox& box = touched_;
  for (std::size_t i = box.first[0]; i < box.last[0]; ++i)
    for (std::size_t j = box.first[1]; j < box.last[1]; ++j)
      for (std::size_t k = box.first[2]; k < box.last[2]; ++k) {
        std::array<double, 4>& value = grid_[(i * nodes_[1] + j) * nodes_[2] + k].value;
        const double mass = value[3];
        if (mass == 0) continue;
        const Vec3 free{value[0] / mass, value[1] / mass, value[2] / mass};
        const Vec3 x{origin_[0] + static_cast<double>(i) * spacing_, origin_[1] + static_cast<double>(j) * spacing_,
                     origin_[2] + static_cast<double>(k) * spacing_};
        const Vec3 velocity = held(x, free);
        for (std::size_t a = 0; a < 3; ++a) {
          impulse_[a] += mass * (velocity[a] - free[a]);
          value[a] = velocity[a];
        }
      }
}

Status Mpm::grid_to_particles(double dt) {
  const std::size_t row = nodes_[2];
  const std::size_t plane = nodes_[1] * nodes_[2];
  double speed_squared_max = 0;
  for (std::size_t p = 0; p < size(); ++p) {
    const Stencil s = stencil(p);
    Vec3 v{};
    Mat3 slope;  // sum of weight * velocity * (node - point)^T, in spacings
    for (std::size_t i = 0; i < 3; ++i)
      for (std::size_t j = 0; j < 3; ++j) {
        const Node* node = &grid_[s.first + i * plane + j * row];
        const double weight_ij = s.weight[0][i] * s.weight[1][j];
        const double di = static_cast<double>(i) - s.offset[0];
        const double dj = static_cast<double>(j) - s.offset[1];
        for (std::size_t k = 0; k < 3; ++k, ++node) {
          const double weight = weight_ij * s.weight[2][k];
          const double dk = static_cast<double>(k) - s.offset[2];
          for (std::size_t a = 0; a < 3; ++a) {
            const double share = weight * node->value[a];
            v[a] += share;
            slope(a, 0) += share * di;
            slope(a, 1) += share * dj;
            slope(a, 2) += share * dk;
          }
        }
      }
    Mat3 growth = Mat3::identity();  // I + dt grad v
    for (std::size_t k = 0; k < 9; ++k) {
      affine_[p].e[k] = 4 / spacing_ * slope.e[k];
      growth.e[k] += dt * affine_[p].e[k];
    }
    deformation_[p] = growth * deformation_[p];
    bool inside = true;
    for (std::size_t a = 0; a < 3; ++a) {
      velocity_[a][p] = v[a];
      position_[a][p] += dt * v[a];
      inside = inside && position_[a][p] >= lo_[a] - spacing_ && position_[a][p] <= hi_[a] + spacing_;
    }
    if (!inside) return left_domain(p);
    speed_squared_max = std::max(speed_squared_max, dot(v, v));
  }
  speed_max_ = std::sqrt(speed_squared_max);
  time_ += dt;
  ++substeps_;
  return {};
}

Status Mpm::left_domain(std::size_t p) const {
  return {Code::invalid_argument,
          fmt::format("point {} left the domain at t = {:.6g} s: it is at ({:.6g}, {:.6g}, {:.6g}), the domain reaches "
                      "from ({:.6g}, {:.6g}, {:.6g}) to ({:.6g}, {:.6g}, {:.6g})",
                      p, time_, position_[0][p], position_[1][p], position_[2][p], lo_[0], lo_[1], lo_[2], hi_[0],
                      hi_[1], hi_[2]),
          "the motion is too violent for this grid: a lower speed or a stiffer material helps"};
}

Balance Mpm::balance() const {
  Balance sum;
  const double affine_scale = spacing_ * spacing_ / 4;  // second moment of the spline
  for (const Body& body : bodies_)
    for (std::size_t p = body.first; p < body.first + body.count; ++p) {
      const Vec3 v{velocity_[0][p], velocity_[1][p], velocity_[2][p]};
      const Vec3 x{position_[0][p], position_[1][p], position_[2][p]};
      const Mat3& c = affine_[p];
      const Vec3 spin{c(2, 1) - c(1, 2), c(0, 2) - c(2, 0), c(1, 0) - c(0, 1)};
      sum.momentum = sum.momentum + body.mass * v;
      sum.angular = sum.angular + body.mass * (cross(x, v) + affine_scale * spin);
      sum.speed_sum += body.mass * norm(v);
      sum.kinetic += 0.5 * body.mass * (dot(v, v) + affine_scale * sum_of_squares(c));
      sum.elastic += body.volume * body.material->energy_density(deformation_[p], memory_[p]);
      sum.potential += potential_of(body.gravity, body.mass, x);
    }
  sum.potential -= potential_start_;
  return sum;
}

}  // namespace rcb::solvers
