#include "novaphy/nova/tape.h"
#include "unrecorded_step.h"

namespace novaphy {

void mark_unrecorded_step(const Model& m, const SimState& in, const SimState& out,
                          const Control* control) {
  nova::Tape* const tape = nova::Tape::active();
  if (tape == nullptr) return;
  const auto carries = [&](const Array& array) {
    if (array.rows() == 0) return false;
    const nova::GradInfo* info = nova::find_grad_info(*array.range());
    return tape->carries_gradient(*array.range()) || (info != nullptr && info->requires_grad);
  };
  const bool any =
      in.requires_grad || carries(in.joint_q) || carries(in.joint_qd) || carries(in.body_f) ||
      carries(in.act) ||
      (control != nullptr &&
       (carries(control->ctrl) || carries(control->joint_f) || carries(control->joint_target_q) ||
        carries(control->joint_target_qd))) ||
      carries(m.body_mass) || carries(m.body_com) || carries(m.body_inertia) ||
      carries(m.joint_target_ke) || carries(m.joint_target_kd) || carries(m.joint_damping) ||
      carries(m.joint_armature) || carries(m.body_gravcomp) || carries(m.actuator_gear) ||
      carries(m.actuator_wrench) || carries(m.actuator_gain) || carries(m.actuator_bias) ||
      carries(m.actuator_time) || carries(m.actuator_ctrl_range) ||
      carries(m.actuator_force_range) || carries(m.actuator_act_range) ||
      carries(m.body_fluid_box) || carries(m.fluid_density) || carries(m.fluid_viscosity) ||
      carries(m.fluid_wind);
  for (const Array* array :
       {static_cast<const Array*>(&out.joint_q), static_cast<const Array*>(&out.joint_qd),
        static_cast<const Array*>(&out.body_q), static_cast<const Array*>(&out.body_qd),
        static_cast<const Array*>(&out.act)}) {
    if (array->rows() == 0) continue;
    if (any) {
      tape->mark_untracked(array->range(),
                           "SolverFeatherstone.step wrote it, which a Tape does not record: use "
                           "DiffFeatherstoneSolver, or record_planar_2r_featherstone_step behind "
                           "the step");
    } else {
      tape->mark_constant(*array->range());
    }
  }
}

}  // namespace novaphy
