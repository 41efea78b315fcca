// StickSprings: static friction of rigid contacts. Each contact row has a tangential spring, which
// persists from step to step. The point id identifies the contact in the next step.
//
//   s  <- P s + ut dt       P removes the normal component; s = 0 in a new row
//   f  = ke s + kf ut       limited to the Coulomb cone: if |f| > c, f becomes f c/|f| and s = f/ke
//
// Symbols: s slip (m), ut slip velocity (m/s) of A against B, world frame; f friction on B (N). The
// contact has the Coulomb limit c (N), the stiffness ke (N/m) and the damping kf (N s/m). At the
// cone the spring alone carries c, so friction on a sliding contact is c for any kf and ke. Below
// the cone, a body under a load rests at s = load/(rows ke) instead of creeping.
//
// Slips persist only into a step that starts from the poses written by the last step. After a
// reset, an edited state or another state they start at zero. A run therefore has the same bits
// regardless of earlier steps of the solver.
// Source: P. A. Cundall, O. D. L. Strack, A Discrete Numerical Model for Granular Assemblies,
// 1979.
#pragma once

#include <vector>

#include "novaphy/core/array_stamp.h"
#include "novaphy/core/sim/contacts.h"

namespace novaphy {

class StickSprings {
 public:
  // Begins a step from the poses `body_q`. Only the first `rows` contacts act.
  void begin(const Contacts& contacts, int32_t rows, const Array& body_q);
  // Returns the friction force (N) of a row. `normal`: unit vector. `limit`: Coulomb limit, >= 0.
  // Call this once per row and step, from any thread.
  Vec3f friction(int64_t row, const Vec3f& normal, const Vec3f& ut, float limit, float kf, float ke,
                 float dt);
  // Ends the step, which wrote the poses `body_q`.
  void end(const Array& body_q);
  // Call this if the poses written to `from` were copied to `to`, and the next step starts from
  // `to`.
  void were_copied(const Array& from, const Array& to) {
    if (last_.matches(from)) last_.set(to);
  }

 private:
  struct Point {
    int32_t shape0, shape1, id;
    Vec3f slip;
  };
  std::vector<Point> points_, before_;
  ArrayStamp last_;  // the poses that the last step wrote
};

}  // namespace novaphy
