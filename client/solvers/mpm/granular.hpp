// Cohesionless sediment: Hencky elasticity inside a Drucker-Prager cone; no tensile strength, no dilatancy.
//
// Sources: Klar et al. 2016, doi:10.1145/2897824.2925906 (log-strain return mapping for sand in the material point
// method); Drucker and Prager 1952, doi:10.1090/qam/48291 (the cone); Tampubolon et al. 2017,
// doi:10.1145/3072959.3073651 (volume gained in separation must be lost again before pressure returns).
//
// 1. After update() every stress lies in the cone: |s| <= sqrt(2) sin(phi) p, p >= 0, with the deviator s and the
//    pressure p of the Kirchhoff stress. This cone matches the Mohr-Coulomb law in plane strain at constant volume; the
//    cone through Mohr-Coulomb's compressive corners, usual in graphics, would be up to 1.4 times as strong there.
// 2. The return mapping reduces the deviator at constant pressure or, from tension, goes to the tip (no stress at all).
//    Both can only lower the stored energy.
// 3. A point's memory is the logarithm of the volume ratio that it gained in separation; 0 while in contact.
// 4. The law is isotropic, so the projection needs no principal axes: it works on strain tensors, and corrects a
//    deformation gradient by a symmetric factor from the left.
#pragma once

#include "client/solvers/mpm/material.hpp"
#include "client/solvers/mpm/symmetric.hpp"

namespace rcb::solvers {

class Granular final : public Material {
 public:
  // density > 0 kg/m^3, youngs_modulus > 0 Pa, -1 < poissons_ratio < 0.5, 0 < friction_angle < 90 degrees.
  static Result<Granular> create(double density, double youngs_modulus, double poissons_ratio, double friction_angle);

  double density() const override { return density_; }
  StressPass update(std::span<Mat3> deformation, std::span<double> memory, std::span<Mat3> kirchhoff) const override;
  double energy_density(const Mat3& deformation, double memory) const override;

  double mu() const { return mu_; }
  double bulk() const { return bulk_; }
  double cone() const { return cone_; }  // largest |s| / p

 private:
  // The result of the return mapping of a trial strain.
  struct Return {
    enum class Kind { kElastic, kCone, kTip } kind;
    double volume;  // trace of the admissible strain: below 0, or 0 at the tip
    Sym3 deviator;  // of the trial strain
    double kept;    // admissible share of the deviator, 0 to 1
    double shear;   // norm of the admissible deviator
  };
  Granular(double density, double mu, double bulk, double cone)
      : density_(density), mu_(mu), bulk_(bulk), cone_(cone) {}
  Return admissible(const Mat3& deformation, double memory) const;

  double density_;
  double mu_;
  double bulk_;
  double cone_;
};

}  // namespace rcb::solvers
