// The largest dt for which the springs and dampers of particles are stable: those of elements and
// contacts.
//
// Law, for particles of mass m_i: x'' = -M^-1 (K x + D x'), in steps of semi-implicit Euler. The
// step leaves the unit circle at -1, where the largest eigenvalue of M^-1 (dt^2 K + 2 dt D) is 4.
// With the blocks K_e, D_e of an element of n_e particles in its rest shape (spring_trace.h,
// triangle_trace.h, bending_trace.h, tetrahedron_trace.h), and sums over the elements e of a
// particle i:
//   enough  dt^2 sum n_e K_e,ii + 2 dt sum n_e D_e,ii <= 4 m_i for all i, because
//           x^T K_e x <= n_e sum_i x_i^T K_e,ii x_i
//   needed  the same without n_e: beyond, one particle diverges even if all others are fixed
// Contacts are those of contact_stability.h, of one particle with a shape (n_e = 1). The stiffness
// ke and the damping kd act along the normal, kd in every second step. The friction kf acts across
// the normal. The bound b = particle_kf_bound limits kf to b m/dt, so friction takes 2 b of the 4.
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

// The forces on particles to include.
struct ParticleForces {
  bool springs = true, triangles = true, edges = true, tetrahedra = true;
  bool contacts = true;  // with every shape that they may touch
  float kf_bound = 1.0f;
};

struct ParticleLimit {
  float dt;               // s; infinite: no limit
  int32_t particle = -1;  // the limiting particle; -1: none
  const char* of = "";    // the limiting force
};

// Returns the `needed` limit of elements, and of one contact with the shape whose ke, kd or kf need
// the smallest step. Reads on the host.
ParticleLimit needed_particle_dt(const Model& model, const ParticleForces& forces);
// Returns the largest dt (s) that is `enough` for elements and for touching contacts of the state.
// Null contacts, with forces.contacts: for one contact with each shape that a particle may touch.
// Infinite: no force acts. Reads from the device without a tape. ErrorKind::Value: a state of
// another model; the message begins with `function`.
NOVAPHY_DYNAMICS_API float enough_particle_dt(const char* function, const Model& model,
                                              const SimState& state, const Contacts* contacts,
                                              const ParticleForces& forces);

// Warns once of a dt above needed_particle_dt. The check runs at calls 1, 2, 4, 8, ... 1024, 2048,
// ..., if dt is larger than before, or if materials, rest shapes or masses were written.
class NOVAPHY_DYNAMICS_API ParticleWatch {
 public:
  explicit ParticleWatch(const char* function) : function_(function) {}
  void look(const Model& model, const ParticleForces& forces, float dt);

 private:
  static constexpr size_t kRead = 12;
  const char* function_;
  uint64_t calls_ = 0;
  bool warned_ = false, had_contacts_ = false;
  float longest_dt_ = 0.0f;  // s
  ArrayStamp read_[kRead];
};

}  // namespace novaphy
