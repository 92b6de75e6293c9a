#include "client/solvers/mpm/granular.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include <fmt/format.h>

namespace rcb::solvers {

Result<Granular> Granular::create(double density, double youngs_modulus, double poissons_ratio, double friction_angle) {
  if (!(friction_angle > 0 && friction_angle < 90))
    return Status(Code::invalid_argument, fmt::format("the friction angle is {}", friction_angle),
                  "give a number between 0 and 90 degrees, both excluded");
  const auto elastic = NeoHookean::create(density, youngs_modulus, poissons_ratio);  // has the same moduli and limits
  if (!elastic) return elastic.status();
  const double cone = std::numbers::sqrt2 * std::sin(friction_angle * std::numbers::pi / 180);
  return Granular(density, elastic->mu(), elastic->lambda() + 2.0 / 3 * elastic->mu(), cone);
}

Granular::Return Granular::admissible(const Mat3& deformation, double memory) const {
  Return result{Return::Kind::kElastic, 0, 0.5 * log(left_square(deformation)), 1, 0};
  const double volume = result.deviator.trace();
  result.volume = volume + memory;
  if (result.volume >= 0) return {Return::Kind::kTip, 0, {}, 0, 0};
  result.deviator.add_to_diagonal(-volume / 3);
  result.shear = std::sqrt(norm_squared(result.deviator));
  const double shear_max = -cone_ * bulk_ * result.volume / (2 * mu_);
  if (result.shear <= shear_max) return result;
  result.kind = Return::Kind::kCone;
  result.kept = shear_max / result.shear;
  result.shear = shear_max;
  return result;
}

StressPass Granular::update(std::span<Mat3> deformation, std::span<double> memory, std::span<Mat3> kirchhoff) const {
  StressPass pass;
  const double stiffness = bulk_ + 4.0 / 3 * mu_;
  double stress_max = 0;
  for (std::size_t p = 0; p < deformation.size(); ++p) {
    Mat3& f = deformation[p];
    const double j = determinant(f);
    if (!(j > 0 && j < std::numeric_limits<double>::infinity())) {
      pass.broken = p;
      return pass;
    }
    const Return strain = admissible(f, memory[p]);
    if (strain.kind == Return::Kind::kTip) {
      memory[p] = std::max(0.0, memory[p] + std::log(j));
      f = Mat3::identity();
      kirchhoff[p] = {};
      continue;
    }
    if (strain.kind == Return::Kind::kCone) f = exp((strain.kept - 1) * strain.deviator).full() * f;
    if (memory[p] != 0) {
      const double stretch = std::exp(memory[p] / 3);
      for (double& entry : f.e) entry *= stretch;
      memory[p] = 0;
    }
    Sym3 stress = (2 * mu_ * strain.kept) * strain.deviator;
    stress.add_to_diagonal(bulk_ * strain.volume);
    kirchhoff[p] = stress.full();
    stress_max = std::max(stress_max, 2 * mu_ * strain.shear - bulk_ * strain.volume);
  }
  // In uniaxial strain rho c^2 is the stiffness minus the stress along the strain, so pressure makes waves faster.
  pass.wave_speed_max = std::sqrt((stiffness + stress_max) / density_);
  return pass;
}

double Granular::energy_density(const Mat3& deformation, double memory) const {
  const Return strain = admissible(deformation, memory);
  return mu_ * strain.shear * strain.shear + 0.5 * bulk_ * strain.volume * strain.volume;
}

}  // namespace rcb::solvers
