#include "novaphy/dynamics/semi_implicit/diff_body_step.h"

#include "novaphy/nova/op_list.h"

namespace novaphy::diff {

using nova::Operand;

namespace {

// Makes `rows_of_six` have `rows` rows of six floats. Keeps the memory if the size is the same.
void fit(Operand& rows_of_six, int64_t rows, Device device) {
  if (rows_of_six.rows == rows) return;
  rows_of_six = {Storage::allocate(static_cast<size_t>(rows) * 6 * sizeof(float), device)->range(),
                 rows, 6};
}

// Returns a view of the same memory with the wrenches of both sides of a contact in one row.
Operand both_sides(Operand wrenches) {
  wrenches.rows /= 2;
  wrenches.width *= 2;
  return wrenches;
}

}  // namespace

bool is_on_host(const Model& model) { return model.device().is_cpu(); }

void BodyStep::begin(const Model& model) { plane_pairs_.update(model, options_.static_contacts); }

void BodyStep::run(const Model& model, const SimState& in, SimState& out, const Operand& body_f,
                   DiffJoints* joints, const Control* control, const Contacts* contacts,
                   const ContactTables& tables, const Operand* of_particles, float dt,
                   const Operand& total) {
  if (nova::current_capture() == nullptr) look(model, in, contacts, tables, dt);
  const Operand q = nova::operand_of(in.body_q), qd = nova::operand_of(in.body_qd);
  Operand f = body_f;
  if (joints != nullptr && joints->act()) {
    fit(joint_wrenches_, 2 * int64_t{model.joint_count()}, model.device());
    const bool more = tables.sides_of_bodies() || of_particles != nullptr;
    if (more) fit(joint_sum_, f.rows, model.device());
    const Operand& sum = more ? joint_sum_ : total;
    joints->add(model, control, q, qd, f, joint_wrenches_, sum);
    f = sum;
  }
  touches_ = tables.sides_of_bodies() != nullptr;
  if (touches_) {
    fit(wrenches_, 2 * int64_t{contacts->rigid_contact_max()}, model.device());
    eval_rigid_contacts(
        model, *contacts, tables, q, qd,
        {options_.friction_law, options_.friction_smoothing, options_.penalty_law, 0.5f * dt},
        both_sides(wrenches_));
    if (of_particles != nullptr) fit(sum_, f.rows, model.device());
    const Operand& sum = of_particles != nullptr ? sum_ : total;
    add_wrenches(f, wrenches_, tables.sides_of_bodies(), sum);
    f = sum;
  }
  if (of_particles != nullptr) {
    add_wrenches(f, *of_particles, tables.slots_of_bodies(), total);
    f = total;
  }
  step_rigid_bodies_with_static_contacts(model, plane_pairs_, q, qd, f,
                                         {.angular_damping = options_.angular_damping,
                                          .friction_smoothing = options_.friction_smoothing,
                                          .dt = dt,
                                          .newton_spin = is_of_newton(options_.friction_law)},
                                         nova::operand_of(out.body_q),
                                         nova::operand_of(out.body_qd));
}

void BodyStep::look(const Model& model, const SimState& in, const Contacts* contacts,
                    const ContactTables& tables, float dt) {
  if (options_.static_contacts) return watch_.look_at_pairs(model, dt);
  // The check reads values on the host. This ends the deferral of steps of many particles.
  const bool is_dear = !is_on_host(model) || model.particle_count() > 0;
  if (tables.sides_of_bodies() == nullptr || !watch_.is_due(is_dear)) return;
  nova::flush_deferred();
  watch_.look(model, in, *contacts, dt, false);
}

void BodyStep::write_contact_forces(const Contacts& contacts) const {
  if (touches_) write_rigid_contact_forces(contacts, both_sides(wrenches_));
}

}  // namespace novaphy::diff
