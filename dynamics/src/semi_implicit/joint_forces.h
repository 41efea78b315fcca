// JointForces: the penalty joints of a step. Every joint gives a wrench on each of its two sides.
// Every body sums its wrenches in the order of the joints, the parent's side before the child's.
#pragma once

#include <vector>

#include "novaphy/core/array_stamp.h"
#include "novaphy/core/sim/control.h"
#include "novaphy/core/sim/index_rows.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"

namespace novaphy {

struct JointAttachOptions {
  float ke, kd;  // SemiImplicitOptions::joint_attach_ke, _kd
};

struct HostJoints;

// Only `prepare` supports models on any device. The other functions need the CPU.
class JointForces {
 public:
  // Throws ErrorKind::NotImplemented, with the array and the row, for a model that penalty joints
  // do not support. `solver` starts the messages.
  static void check_covered(const Model& model, const char* solver);

  // Calls check_covered again if one of its arrays was written, and checks joint_act of the control
  // or the model. After a capture, a replay throws if such an array was written since.
  void check_edits(const Model& model, const Control* control, const char* solver);
  // Finds the joint sides of every body again if the joints were written. ErrorKind::Value: dt is
  // above the stable step of a joint.
  void prepare(const Model& model, const JointAttachOptions& attach, float dt);
  // Evaluates the wrenches. Null control: the forces and targets of the model.
  void evaluate(const Model& model, const SimState& state, const Control* control,
                const JointAttachOptions& attach);
  bool empty() const { return bodies_.empty(); }
  SpatialVectorf add(int64_t body, SpatialVectorf wrench) const;

 private:
  void find_sides(const HostJoints& joints, int32_t body_count);

  std::vector<ArrayStamp> covered_;
  ArrayStamp enabled_, mass_, inertia_, flags_;
  float stable_dt_ = 0.0f;       // s: longer steps make the attachment of a joint diverge
  int32_t unstable_joint_ = -1;  // the joint with the shortest stable step
  std::vector<int32_t> bodies_;  // bodies of both sides of every joint; -1: the world, or no force
  IndexRows sides_;
  std::vector<SpatialVectorf> wrenches_;
};

}  // namespace novaphy
