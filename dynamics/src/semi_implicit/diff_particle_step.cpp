#include "novaphy/dynamics/semi_implicit/diff_particle_step.h"

#include "novaphy/collision/contact_bodies.h"
#include "novaphy/collision/diff_soft_contact_trace.h"
#include "novaphy/core/error.h"
#include "novaphy/dynamics/diff_model_reads.h"
#include "novaphy/dynamics/semi_implicit/diff_particles.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"

namespace novaphy::diff {

using nova::Operand;

namespace {

Operand allocate(int64_t rows, int32_t width, Device device) {
  const auto bytes = static_cast<size_t>(rows) * static_cast<size_t>(width) * sizeof(float);
  return {Storage::allocate(bytes, device)->range(), rows, width};
}

bool particles_may_meet_moving_points(const Model& model) {
  if (particles_may_meet_bodies(model)) return true;
  const std::vector<int32_t> type = model.shape_type.to_host(), flags = model.shape_flags.to_host();
  for (size_t s = 0; s < type.size(); ++s)
    if (has_flag(flags[s], ShapeFlags::COLLIDE_PARTICLES) &&
        static_cast<GeoType>(type[s]) != GeoType::PLANE)
      return true;
  return false;
}

}  // namespace

ParticleStep::ParticleStep(const Model& model, const ParticleStepOptions& options)
    : options_(options),
      elements_(model, options.elements),
      meets_bodies_(options.contacts && particles_may_meet_bodies(model)),
      contacts_move_(options.contacts && model.particle_count() > 0 &&
                     particles_may_meet_moving_points(model)) {
  rows_.update(model, options.static_contacts);
}

Operand ParticleStep::add_elements(const Model& model, const Control* control, const Operand& q,
                                   const Operand& qd, const Operand& f, const Operand& to) {
  if (elements_.empty()) return f;
  elements_.eval(model, control, q, qd, f, to);
  return to;
}

void ParticleStep::add_contacts(const Model& model, const SimState& in, const Contacts& contacts,
                                const ContactTables& tables, const Operand& f, float dt,
                                const Operand& to) {
  const float rate = kf_rate(options_.kf_bound, dt);
  const Operand q = nova::operand_of(in.particle_q), qd = nova::operand_of(in.particle_qd);
  if (tables.soft_bodies().rows() == 0) {
    eval_soft_contact_forces(model, contacts, tables.slots_of_particles(), q, qd, f, rate, to);
    return;
  }
  touches_ = meets_bodies_;
  if (forces_.rows != contacts.soft_contact_max()) {
    forces_ = allocate(contacts.soft_contact_max(), 3, model.device());
    wrenches_ = allocate(contacts.soft_contact_max(), 6, model.device());
  }
  eval_soft_contacts(model, contacts, tables, q, qd, nova::operand_of(in.body_q),
                     nova::operand_of(in.body_qd), rate, forces_, wrenches_);
  detail::add_contributions(f, forces_, tables.slots_of_particles(), to);
}

std::vector<ScratchSpec> ParticleStep::scratch() const {
  // Memory for the forces with those of the elements, and for the sum with those of the contacts.
  return {size_t{has_elements()} + size_t{contacts_move_},
          {DType::vec3, elements_.particle_count(), 1}};
}

void ParticleStep::begin(const Model& model, const char* function) {
  begin_model_reads(model, function);
  rows_.update(model, options_.static_contacts);
}

void ParticleStep::run(const Model& model, SimState& in, SimState& out, const Control* control,
                       const Contacts* contacts, const ContactTables& tables, float dt) {
  const Operand q = nova::operand_of(in.particle_q), qd = nova::operand_of(in.particle_qd);
  const Operand applied = nova::operand_of(in.particle_f);
  touches_ = false;
  // Recorded forces need memory of the tape. The state's own array gets a copy, so the user can
  // clear and reuse that array.
  const bool recording = nova::Tape::active() != nullptr;
  const auto target = [&] {
    if (!recording) return applied;
    Operand total = applied;
    total.range = Storage::allocate(applied.range->bytes(), model.device(), false)->range();
    return total;
  };
  Operand f = applied;
  if (!elements_.empty()) f = add_elements(model, control, q, qd, f, target());
  if (tables.slots_of_particles() || options_.static_contacts) {
    const Operand total = target();
    if (options_.static_contacts) {
      eval_static_contact_forces(model, rows_, q, qd, f, kf_rate(options_.kf_bound, dt),
                                 options_.static_contact_margin, total);
    } else {
      add_contacts(model, in, *contacts, tables, f, dt, total);
    }
    f = total;
  }
  if (f.range != applied.range) {
    nova::submit_copy(applied.range, f.range);
    const Operand recorded[] = {f};
    if (nova::Tape::active()->must_record(recorded))
      nova::Tape::active()->mark_untracked(
          applied.range,
          "particle_f holds a copy of recorded values, through which no gradient would flow; clear "
          "it before it is used again");
  }
  integrate_particles(model, q, qd, f, dt, nova::operand_of(out.particle_q),
                      nova::operand_of(out.particle_qd));
}

void ParticleStep::record(const Model& model, const SimState& in, SimState& out,
                          const StepInputs& inputs, const ContactTables& tables,
                          StepScratch scratch) {
  const Operand q = nova::operand_of(in.particle_q), qd = nova::operand_of(in.particle_qd);
  const Operand q_out = nova::operand_of(out.particle_q),
                qd_out = nova::operand_of(out.particle_qd);
  touches_ = false;
  const Operand f = elements_.empty() ? inputs.forces
                                      : add_elements(model, inputs.control, q, qd, inputs.forces,
                                                     nova::operand_of(scratch[0]));
  const float rate = kf_rate(options_.kf_bound, inputs.dt);
  if (options_.static_contacts) {
    step_particles_with_static_contacts(model, rows_, q, qd, f, rate,
                                        options_.static_contact_margin, inputs.dt, q_out, qd_out);
  } else if (tables.soft_bodies().rows() > 0) {
    const Operand total = nova::operand_of(scratch[has_elements() ? 1 : 0]);
    add_contacts(model, in, *inputs.contacts, tables, f, inputs.dt, total);
    integrate_particles(model, q, qd, total, inputs.dt, q_out, qd_out);
  } else if (tables.slots_of_particles()) {
    step_particles(model, *inputs.contacts, tables.slots_of_particles(), q, qd, f, rate, inputs.dt,
                   q_out, qd_out);
  } else {
    integrate_particles(model, q, qd, f, inputs.dt, q_out, qd_out);
  }
}

}  // namespace novaphy::diff
