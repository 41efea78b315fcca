// Static friction of rigid contacts: a tangential spring for every row, kept from step to step by
// the name of its point.
//
//   s  <- P s + ut dt            P takes off what is along the normal; s = 0 in a row that is new
//   f  = ke s + kf ut, cut off at the Coulomb limit c: f c/|f|, and then s = f/ke: the spring by
//        itself ends at the cone, so what slides is braked by c whatever kf and ke are
// Symbols: s slip (m), ut slip velocity (m/s) of A against B, world frame; f friction on B (N).
// Under a load below the cone a body rests at s = load/(rows ke) instead of creeping.
//
// Slips carry over only into the step that follows: from the very poses that the last step wrote.
// After a reset, an edited state or another state they start anew, so a run has the same bits
// whatever the solver did before.
// Source: P. A. Cundall, O. D. L. Strack, A Discrete Numerical Model for Granular Assemblies, 1979.
#pragma once

#include <vector>

#include "novaphy/core/array_stamp.h"
#include "novaphy/core/sim/contacts.h"

namespace novaphy {

class StickSprings {
 public:
  // The first `rows` of the contacts act, in a step from `body_q`.
  void begin(const Contacts& contacts, int32_t rows, const Array& body_q);
  // Of a row, with its unit normal and the limit >= 0; each row once in a step, on any thread.
  Vec3f friction(int64_t row, const Vec3f& normal, const Vec3f& ut, float limit, float kf, float ke,
                 float dt);
  // The step wrote these poses.
  void end(const Array& body_q);

 private:
  struct Point {
    int32_t shape0, shape1, id;
    Vec3f slip;
  };
  std::vector<Point> points_, before_;
  ArrayStamp last_;  // the poses that the last step wrote
};

}  // namespace novaphy
