// The largest dt for which the springs and dampers of rigid contacts are stable.
//
// Law, for the contact rows that touch, with the normal n and the arm r from the center of mass of
// a body:
//   K = sum ke J(n) J(n)^T + stick_ke T,  D = sum kd J(n) J(n)^T + kf T,
//   T = sum_u J(u) J(u)^T - J(n) J(n)^T, u the three axes,  J(u) = (u, r x u),  M mass and inertia
// The motion is x'' = -M^-1 (K x + D x'), in steps of semi-implicit Euler. A step is unstable (it
// has an eigenvalue below -1) if the largest eigenvalue of M^-1 (dt^2 K + 2 dt D) exceeds 4.
// Dampers along the normal only push apart. In an oscillation at the limit they act in every second
// step, so dt^2 K + dt D replaces dt^2 K + 2 dt D for them.
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
  float dt;           // s; infinite: no limit
  int32_t body = -1;  // the limiting body; -1: none
};

// Enough: a sufficient limit, below which dt is safe. K and D count fully, and twice for rows of
// two moving bodies, which allows for neighbors in antiphase. Needed: a necessary limit, above
// which a step diverges even if all other bodies are fixed. ke and kd count once, and kf of rows
// with friction is tested separately.
enum class Stability { Enough, Needed };

namespace detail {
struct TouchingRows;
}

// Returns the largest dt (s) for which the springs and dampers of touching contacts are stable,
// with sticking friction and for any motion of neighbors. Infinite: no contact touches. Reads from
// the device without a tape. ErrorKind::Value: a state or contacts of another model, or contacts
// that have overflowed. The message begins with `function`.
NOVAPHY_DYNAMICS_API float stable_contact_dt(const char* function, const Model& model,
                                             const SimState& state, const Contacts& contacts,
                                             float stick_ke);

// Warns once about each of these faults:
//   a dt at which ke and kd of touching contacts diverge even if all other bodies are fixed
//   a dt at which kf diverges, for a friction law with slope kf at zero slip: friction chatters
//   a body that rests deeper than a quarter of its radius of gyration
//   a body whose pose is not finite, and which therefore has no contacts
// A body is checked when the set of shapes that touch it, or their number of rows, changes. Depths
// are checked in every 32nd step, and poses in steps 1, 2, 4, 8, ..., 1024, 2048, 3072, ...
class NOVAPHY_DYNAMICS_API ContactWatch {
 public:
  // Messages begin with `function`. Messages about dt end with `advice`.
  explicit ContactWatch(const char* function,
                        const char* advice =
                            "stable_dt(state, contacts) says what is safe, and "
                            "SolverFeatherstone needs none of them")
      : function_(function), advice_(advice) {}
  // Skips the check of kf, for a friction law whose slope at zero slip is below kf.
  void leave_out_friction() { warned_of_friction_ = true; }

  // Counts a step, and returns whether to check it: every step, or if checks are expensive
  // (`is_dear`), steps 1, 2, 4, 8, ... 1024, 2048, 3072, ...
  bool is_due(bool is_dear);
  // Checks a step on the host. The rows must name existing shapes and bodies. `bodies`: nonzero for
  // each body to check; null: all. `pushed`: whether rigid_contact_force belongs to the present
  // rows, so that it shows which rows touch.
  void look(const Model& model, const SimState& state, const Contacts& contacts, float dt,
            bool pushed, const std::vector<uint8_t>* bodies = nullptr);
  // Check for contacts that are not stored: tests the softest contact of each of the model's pairs
  // of shapes, as one row through the center of mass. The check runs only if dt is larger than
  // before, or if ke, kd, kf or masses were written.
  void look_at_pairs(const Model& model, float dt);

 private:
  // Hashes of the objects that touch a body now and that have touched it; 0: none.
  struct Touched {
    uint32_t now = 0, seen[4] = {};
    int32_t next = 0;      // entry of `seen` to overwrite next
    int32_t changed = -1;  // index among the changed bodies; -1: unchanged
  };
  // The supporting contacts of a body: the depth of the deepest (m), the weight that springs carry
  // (N), the largest stiffness (N/m), and their number.
  struct Load {
    float depth = 0.0f, lift = 0.0f, stiffest = 0.0f;
    int32_t rows = 0;
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
  float longest_dt_ = 0.0f;                  // s, largest dt so far
  ArrayStamp read_[5];                       // stamps of the arrays that were read
  std::vector<Touched> touched_;             // per body
  std::vector<int32_t> touching_, changed_;  // bodies
  std::vector<Load> loads_;                  // per body
};

}  // namespace novaphy
