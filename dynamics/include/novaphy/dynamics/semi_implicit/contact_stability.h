// Up to which dt the springs and dampers of rigid contacts are stable.
//
// Law, for the rows that touch, n the normal and r the arm from the center of mass of a body:
//   K = sum ke J(n) J(n)^T + stick_ke T,  D = sum kd J(n) J(n)^T + kf T,
//   T = sum_u J(u) J(u)^T - J(n) J(n)^T, u the three axes,  J(u) = (u, r x u),  M mass and inertia
//   x'' = -M^-1 (K x + D x') in steps of semi-implicit Euler leaves the unit circle at -1, where
//   the largest eigenvalue of M^-1 (dt^2 K + 2 dt D) is 4.
// Dampers along the normal only push apart: they act in every other of the steps that swing there,
// and the eigenvalue is that of dt^2 K + dt D.
#pragma once

#include <cstdint>
#include <vector>

#include "novaphy/core/array_stamp.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/dynamics/export.h"

namespace novaphy {

struct ContactLimit {
  float dt;           // s; infinite: none
  int32_t body = -1;  // that has it
};

// Enough: K and D in full, those of rows of two bodies that move twice, which allows for neighbors
// in antiphase. Needed: a longer dt diverges though the other bodies are held: ke, and kd once; and
// by itself kf, of rows with friction.
enum class Stability { Enough, Needed };

namespace detail {
struct TouchingRows;
}

// The longest dt (s) at which springs and dampers of what touches are stable, friction as far as it
// sticks, whatever the neighbors of a body do; infinite: none touches. Reads from the device; no
// tape sees it. `function` starts the message of ErrorKind::Value: a state or contacts of another
// model, contacts that have overflowed.
NOVAPHY_DYNAMICS_API float stable_contact_dt(const char* function, const Model& model,
                                             const SimState& state, const Contacts& contacts,
                                             float stick_ke);

// Warns, once each:
//   of a dt at which ke and kd of what touches diverge even with all but one body held
//   of one at which kf does, of a friction law whose slope at rest is kf: it shakes at its cone
//   of a body that rests deeper than a quarter of its radius of gyration
//   of a body whose pose is not finite, which meets nothing
// It looks at a body whenever the shapes that touch it, or in how many rows, are others than
// before, at depths in every 32nd step, and at poses in steps 1, 2, 4, 8, ..., 1024, 2048, 3072,
// ...
class NOVAPHY_DYNAMICS_API ContactWatch {
 public:
  // `function` starts the messages, `advice` ends those of dt.
  explicit ContactWatch(const char* function,
                        const char* advice =
                            "stable_dt(state, contacts) says what is safe, and "
                            "SolverFeatherstone needs none of them")
      : function_(function), advice_(advice) {}
  // Of a law of friction whose slope at rest is less than kf.
  void leave_out_friction() { warned_of_friction_ = true; }

  // Counts a step, and says whether it is one to look at: every one, or where looking is dear
  // steps 1, 2, 4, 8, ... 1024, 2048, 3072, ...
  bool is_due(bool is_dear);
  // Reads on the host. The rows must be of shapes and bodies that are there. `bodies`: nonzero for
  // those to look at; null: all. `pushed`: rigid_contact_force is that of the
  // rows as they are, which says what touches.
  void look(const Model& model, const SimState& state, const Contacts& contacts, float dt,
            bool pushed, const std::vector<uint8_t>* bodies = nullptr);
  // For contacts that nothing holds: what the softest contact of one of the model's pairs of shapes
  // does, one row through the center of mass. It looks only while dt is longer than before, or ke,
  // kd, kf or masses were written.
  void look_at_pairs(const Model& model, float dt);

 private:
  // What has touched a body, as numbers; 0: nothing.
  struct Touched {
    uint32_t now = 0, seen[4] = {};
    int32_t next = 0;      // of seen
    int32_t changed = -1;  // its place among those that changed
  };
  // Of a body: its deepest contact that carries it, and what springs carry of its weight, N.
  struct Load {
    float depth = 0.0f, lift = 0.0f;
  };
  void find_changed(const detail::TouchingRows& rows, const Model& model, float dt);
  void check(const ContactLimit& limit, float dt);
  void check_friction(const ContactLimit& limit, float dt);
  void check_poses(const SimState& state);
  void check_depths(const detail::TouchingRows& rows, const Model& model);

  const char *function_, *advice_;
  uint64_t steps_ = 0;
  bool warned_ = false, warned_of_friction_ = false, warned_of_depth_ = false,
       warned_of_pose_ = false;
  float longest_dt_ = 0.0f;                  // s, that was looked at
  ArrayStamp read_[5];                       // as they were
  std::vector<Touched> touched_;             // of bodies
  std::vector<int32_t> touching_, changed_;  // bodies
  std::vector<Load> loads_;                  // of bodies
};

}  // namespace novaphy
