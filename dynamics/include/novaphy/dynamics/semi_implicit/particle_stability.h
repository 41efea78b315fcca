// The largest dt for which the springs and dampers that act on particles (of elements and contacts)
// are stable.
//
// Law, for particles of mass m_i: x'' = -M^-1 (K x + D x'), in steps of semi-implicit Euler. The
// step becomes unstable (an eigenvalue of the step passes -1) where the largest eigenvalue of M^-1
// (dt^2 K + 2 dt D) is 4. K_e, D_e are the blocks of an element of n_e particles in its rest shape
// (spring_trace.h, triangle_trace.h, bending_trace.h, tetrahedron_trace.h). Sums are over the
// elements e of a particle i:
//   sufficient  dt^2 sum n_e K_e,ii + 2 dt sum n_e D_e,ii <= 4 m_i for all i, because
//               x^T K_e x <= n_e sum_i x_i^T K_e,ii x_i
//   necessary   the same without n_e: else a particle diverges even if all others are fixed
// Contacts are those of contact_stability.h, of one particle with a shape (n_e = 1). The stiffness
// ke and the damping kd act along the normal, kd in every second step. The friction kf acts across
// the normal. The bound b = particle_kf_bound limits kf to b m/dt, so friction contributes at most
// 2 b to the limit 4.
#pragma once

#include <cstdint>
#include <vector>

#include "novaphy/core/array_stamp.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/dynamics/export.h"
#include "novaphy/dynamics/semi_implicit/contact_stability.h"

namespace novaphy {

// Selects the forces on particles to include.
struct ParticleForces {
  bool springs = true, triangles = true, edges = true, tetrahedra = true;
  bool contacts = true;  // contacts with every shape that they may touch
  float kf_bound = 1.0f;
};

struct ParticleLimit {
  float dt;               // s; infinite: no limit
  int32_t particle = -1;  // the limiting particle; -1: none
  const char* of = "";    // the limiting force
};

// Returns a necessary limit of dt. Above the limit an element is unstable, or one contact with the
// shape whose ke, kd or kf needs the smallest step. Copies arrays of a device to the host.
ParticleLimit needed_particle_dt(const Model& model, const ParticleForces& forces);
// Returns the largest dt (s) that is `enough` for elements and for touching contacts of the state.
// If contacts are null and forces.contacts is set, each particle counts one contact with each shape
// that it may touch. Infinite: no force acts. Reads from the device without a tape.
// ErrorKind::Value: a state of another model; the message begins with `function`.
NOVAPHY_DYNAMICS_API float enough_particle_dt(const char* function, const Model& model,
                                              const SimState& state, const Contacts* contacts,
                                              const ParticleForces& forces);

// Warns once if dt exceeds needed_particle_dt. The check runs at calls 1, 2, 4, 8, ... 1024, 2048,
// ..., and then only if dt is larger than before, or if materials, rest shapes or masses were
// written.
class NOVAPHY_DYNAMICS_API ParticleWatch {
 public:
  explicit ParticleWatch(const char* function) : function_(function) {}
  void look(const Model& model, const ParticleForces& forces, float dt);

 private:
  static constexpr size_t kRead = 13;
  const char* function_;
  uint64_t calls_ = 0;
  bool warned_ = false, had_contacts_ = false;
  float longest_dt_ = 0.0f;  // s
  ArrayStamp read_[kRead];
};

}  // namespace novaphy
