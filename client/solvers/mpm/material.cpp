#include "client/solvers/mpm/material.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

namespace rcb::solvers {

Result<NeoHookean> NeoHookean::create(double density, double youngs_modulus, double poissons_ratio) {
  if (!(density > 0) || !std::isfinite(density))
    return Status(Code::invalid_argument, fmt::format("the density is {}", density),
                  "give a number above 0, in kg/m^3");
  if (!(youngs_modulus > 0) || !std::isfinite(youngs_modulus))
    return Status(Code::invalid_argument, fmt::format("Young's modulus is {}", youngs_modulus),
                  "give a number above 0, in Pa");
  if (!(poissons_ratio > -1 && poissons_ratio < 0.5))
    return Status(Code::invalid_argument, fmt::format("Poisson's ratio is {}", poissons_ratio),
                  "give a number between -1 and 0.5, both excluded");
  const double mu = youngs_modulus / (2 * (1 + poissons_ratio));
  const double lambda = youngs_modulus * poissons_ratio / ((1 + poissons_ratio) * (1 - 2 * poissons_ratio));
  return NeoHookean(density, mu, lambda);
}

StressPass NeoHookean::update(std::span<Mat3> deformation, std::span<double> /*memory*/,
                              std::span<Mat3> kirchhoff) const {
  StressPass pass;
  double stiffness_max = 0;
  for (std::size_t p = 0; p < deformation.size(); ++p) {
    const Mat3& f = deformation[p];
    const double j = determinant(f);
    if (!(j > 0 && j < std::numeric_limits<double>::infinity())) {
      pass.broken = p;
      return pass;
    }
    const double log_j = std::log(j);
    const Mat3 b = times_transpose(f);
    // A wave along the unit vector n in the deformed body has rho c^2 = mu (n.b n + 1) + lambda (1 - ln J), where n.b n
    // is at most the largest row sum of |b| (Gershgorin).
    double stretch = 0;
    for (std::size_t i = 0; i < 3; ++i)
      stretch = std::max(stretch, std::abs(b(i, 0)) + std::abs(b(i, 1)) + std::abs(b(i, 2)));
    stiffness_max = std::max(stiffness_max, mu_ * (stretch + 1) + lambda_ * (1 - log_j));
    Mat3& tau = kirchhoff[p];
    for (std::size_t k = 0; k < 9; ++k) tau.e[k] = mu_ * b.e[k];
    const double pressure = lambda_ * log_j - mu_;
    for (std::size_t i = 0; i < 3; ++i) tau(i, i) += pressure;
  }
  pass.wave_speed_max = std::sqrt(stiffness_max / density_);
  return pass;
}

double NeoHookean::energy_density(const Mat3& deformation, double /*memory*/) const {
  const double log_j = std::log(determinant(deformation));
  return 0.5 * mu_ * (sum_of_squares(deformation) - 3) - mu_ * log_j + 0.5 * lambda_ * log_j * log_j;
}

}  // namespace rcb::solvers
