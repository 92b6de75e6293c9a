// Material laws: the interface between the material point method and the points' constitutive behaviour.
//
// 1. A law sees deformation gradients only, neither grid nor neighbours.
// 2. update() may replace a deformation gradient by its admissible elastic part (the return mapping of a plastic law);
//    an elastic law leaves it unchanged.
// 3. A law may keep one internal (history) variable for each point in `memory`, initially 0; only the law reads it.
#pragma once

#include <cstddef>
#include <limits>
#include <span>

#include "client/solvers/mpm/mat3.hpp"
#include "common/base/status.hpp"

namespace rcb::solvers {

struct StressPass {
  static constexpr std::size_t kNone = std::numeric_limits<std::size_t>::max();

  double wave_speed_max = 0;   // m/s, in the deformed body; limits the time step
  std::size_t broken = kNone;  // first point with an impossible deformation (turned inside out, or not finite)
};

class Material {
 public:
  virtual ~Material() = default;

  virtual double density() const = 0;  // undeformed, kg/m^3
  // Computes the Kirchhoff stress of each point, in Pa (Cauchy stress times the volume ratio).
  //   deformation  [count], deformation gradients; changed by a plastic law
  //   memory       [count], the law's own
  //   kirchhoff    [count], written; incomplete from a broken point on
  virtual StressPass update(std::span<Mat3> deformation, std::span<double> memory, std::span<Mat3> kirchhoff) const = 0;
  // Stored energy per undeformed volume, J/m^3; for a plastic law that after its return mapping.
  virtual double energy_density(const Mat3& deformation, double memory) const = 0;
};

// Compressible neo-Hookean solid: psi = mu/2 (tr(F F^T) - 3) - mu ln J + lambda/2 (ln J)^2.
// Source: Bonet and Wood 2008, section 6.4.3, doi:10.1017/CBO9780511755446.
class NeoHookean final : public Material {
 public:
  // density > 0 kg/m^3, youngs_modulus > 0 Pa, -1 < poissons_ratio < 0.5 (small strains).
  static Result<NeoHookean> create(double density, double youngs_modulus, double poissons_ratio);

  double density() const override { return density_; }
  StressPass update(std::span<Mat3> deformation, std::span<double> memory, std::span<Mat3> kirchhoff) const override;
  double energy_density(const Mat3& deformation, double memory = 0) const override;
  double mu() const { return mu_; }
  double lambda() const { return lambda_; }

 private:
  NeoHookean(double density, double mu, double lambda) : density_(density), mu_(mu), lambda_(lambda) {}

  double density_;
  double mu_;
  double lambda_;
};

}  // namespace rcb::solvers
