// The parameters of a step, computed from the options and from scalars of the model.
#pragma once

#include <cmath>
#include <vector>

#include "novaphy/core/error.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/vbd/solver_vbd.h"

namespace novaphy::vbd {

// Raises an error for scalars of the model that this solver does not support.
inline void check_numbers(const Model& model) {
  constexpr const char* kName = "SolverVBD.step";
  model.check_numbers(kName);
  require(model.particle_adhesion == 0.0f, ErrorKind::NotImplemented, kName,
          ": model.particle_adhesion: not supported, expected 0, got ", model.particle_adhesion);
  require(model.particle_max_velocity >= ModelNumbers{}.particle_max_velocity,
          ErrorKind::NotImplemented, kName,
          ": model.particle_max_velocity: not supported, expected the default, got ",
          model.particle_max_velocity);
  require(model.soft_contact_kf == ModelNumbers{}.soft_contact_kf, ErrorKind::NotImplemented, kName,
          ": model.soft_contact_kf: expected the default ", ModelNumbers{}.soft_contact_kf,
          ", because friction of VBD has no part of it (friction_epsilon), got ",
          model.soft_contact_kf);
  require(model.soft_contact_restitution == ModelNumbers{}.soft_contact_restitution,
          ErrorKind::NotImplemented, kName,
          ": model.soft_contact_restitution: expected the default ",
          ModelNumbers{}.soft_contact_restitution, ", because contacts of VBD do not bounce, got ",
          model.soft_contact_restitution);
}

// Raises an error for options that need a decision of the host during a step. A device or a
// recording cannot wait for the host.
inline void check_not_launched(const VbdOptions& o) {
  require(!o.tolerance, ErrorKind::NotImplemented,
          "SolverVBD: tolerance: a step that is launched does not ask how far it is (on a device, "
          "or in a capture); set iterations");
  require(
      !o.converged, ErrorKind::NotImplemented,
      "SolverVBD: solve: expected \"iterations\" for a step that is launched (on a device, or in "
      "a capture), got \"converged\", for which the host decides how far to go");
  require(!o.self_contact, ErrorKind::NotImplemented,
          "SolverVBD: particle_enable_self_contact: expected False for a step that is launched (on "
          "a device, or in a capture), got True");
}

// Returns the factors omega of Chebyshev acceleration for each iteration, with rho the spectral
// radius. omega is 1 up to the first iteration, 2/(2 - rho^2) in the second, then 4/(4 - rho^2
// omega) with the previous omega.
inline std::vector<float> chebyshev_factors(float radius, int32_t iterations) {
  const double rho2 = static_cast<double>(radius) * static_cast<double>(radius);
  std::vector<float> factors;
  double omega = 1.0;
  for (int32_t k = 0; k <= iterations; ++k) {
    if (k >= 2) omega = k == 2 ? 2.0 / (2.0 - rho2) : 4.0 / (4.0 - rho2 * omega);
    factors.push_back(static_cast<float>(omega));
  }
  return factors;
}

}  // namespace novaphy::vbd
