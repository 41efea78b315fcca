// Differentiable penalty joints, in two steps. First, a kernel over the joints writes the wrenches
// of each joint on its two bodies (penalty_joint_trace.h). Then a sum over the bodies adds these
// wrenches in the order of the joints, with the parent's side before the child's. Compiled into
// novaphy::dynamics if nova is built.
//
// The gradient of each input:
//   body_q, body_qd                                                     exact
//   joint_f, joint_target_q, joint_target_qd (the control's or the model's)   exact
//   model: joint_target_ke, _kd, joint_limit_ke, _kd, _lower, _upper, joint_damping,
//       joint_effort_limit, joint_X_p, joint_X_c, joint_axis, body_com  exact, for the active
//         branch
//   joint_attach_ke, _kd, types, modes, joint_enabled                   none
#pragma once

#include <memory>

#include "novaphy/core/array_stamp.h"
#include "novaphy/core/sim/control.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/dynamics/export.h"
#include "novaphy/nova/incidence.h"
#include "novaphy/nova/kernel.h"

namespace novaphy {
class JointForces;
}

namespace novaphy::diff {

// Keeps tables between calls. Only one thread at a time may use an object.
class NOVAPHY_DYNAMICS_API DiffJoints {
 public:
  // The spring and damper that hold the bodies of a joint together. ke: N/m and N*m/rad. kd: N*s/m
  // for positions, and 0.01 kd in N*m*s/rad for rotations.
  struct Attach {
    float ke = 1.0e4f, kd = 1.0e2f;
  };
  // ErrorKind::NotImplemented: a feature that penalty joints do not support. ErrorKind::Value: an
  // invalid stiffness or damping. Messages name the array.
  DiffJoints(const Model& model, const Attach& attach);
  ~DiffJoints();
  DiffJoints(DiffJoints&&) noexcept;
  DiffJoints& operator=(DiffJoints&&) noexcept;

  // Prepares all steps of a solver call. A FREE joint counts only if the model or `control` (null:
  // none) has a force along it. ErrorKind::Value: dt is above the stable step of a joint.
  // ErrorKind::NotImplemented: as for the constructor, for values written since.
  void begin(const Model& model, const Control* control, float dt);
  // Returns whether a joint exerts a force.
  bool act() const { return act_; }
  // Computes `sum` {b, 6} = `body_f` plus the wrenches of the joints. `wrenches` {2 joints, 6} is
  // scratch memory.
  void add(const Model& model, const Control* control, const nova::Operand& body_q,
           const nova::Operand& body_qd, const nova::Operand& body_f, const nova::Operand& wrenches,
           const nova::Operand& sum);

 private:
  void find_tables(const Model& model);

  Attach attach_;
  bool act_ = false, hold_ = false;  // hold_: whether the model has joints that are not FREE
  std::unique_ptr<JointForces> checks_;
  ArrayStamp enabled_;
  DeviceArray<int32_t> sides_, layout_, dofs_, coordinates_;
  nova::Incidence sides_of_bodies_;
  const nova::Kernel* kernel_ = nullptr;
};

}  // namespace novaphy::diff
