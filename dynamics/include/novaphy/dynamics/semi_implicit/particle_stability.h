// Up to which dt the springs and dampers of particles are stable: elements, and contacts.
//
// Law, for particles of mass m_i: x'' = -M^-1 (K x + D x'), in steps of semi-implicit Euler. The
// step leaves the unit circle at -1, where the largest eigenvalue of M^-1 (dt^2 K + 2 dt D) is 4.
// With the blocks K_e, D_e of an element of n_e particles at rest (spring_trace.h,
// triangle_trace.h, bending_trace.h, tetrahedron_trace.h), sums over the elements e of a particle
// i:
//   enough  dt^2 sum n_e K_e,ii + 2 dt sum n_e D_e,ii <= 4 m_i for all i, because
//           x^T K_e x <= n_e sum_i x_i^T K_e,ii x_i
//   needed  the same without n_e: one particle diverges though all others are held
// Contacts are those of contact_stability.h, of one particle with a shape (n_e = 1). Along the
// normal act ke and kd, where kd acts in every other step. Across the normal acts kf. The bound b =
// particle_kf_bound limits kf to b m/dt: friction then has 2 b of the 4.
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

// What acts on particles.
struct ParticleForces {
  bool springs = true, triangles = true, edges = true, tetrahedra = true;
  bool contacts = true;  // with any shape that they may meet
  float kf_bound = 1.0f;
};

struct ParticleLimit {
  float dt;               // s; infinite: none
  int32_t particle = -1;  // that has it
  const char* of = "";    // what
};

// `needed` of elements, and of one contact with the shape whose ke, kd or kf need the shortest
// step. Reads on the host.
ParticleLimit needed_particle_dt(const Model& model, const ParticleForces& forces);
// The longest dt (s) that is `enough` for elements and for the contacts that touch in the state;
// without contacts (null) for one with each shape that a particle may meet, if forces.contacts.
// Infinite: none act. Reads from the device; no tape sees it. `function` starts the message of
// ErrorKind::Value: a state of another model.
NOVAPHY_DYNAMICS_API float enough_particle_dt(const char* function, const Model& model,
                                              const SimState& state, const Contacts* contacts,
                                              const ParticleForces& forces);

// Warns, once, of a dt above needed_particle_dt. It looks at calls 1, 2, 4, 8, ... 1024, 2048, ...,
// while dt is longer than before or materials, rest shapes or masses were written.
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
