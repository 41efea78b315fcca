#include "novaphy/dynamics/semi_implicit/diff_particle_step.h"

#include "novaphy/core/error.h"
#include "novaphy/dynamics/diff_model_reads.h"
#include "novaphy/dynamics/semi_implicit/diff_particles.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"

namespace novaphy::diff {

using nova::Operand;

ParticleStep::ParticleStep(const Model& model, const ParticleStepOptions& options)
    : options_(options), elements_(model, options.elements) {
  rows_.update(model, options.static_contacts);
  if (options.static_contacts) detail::check_static_shapes(model);
}

Operand ParticleStep::add_elements(const Model& model, const Control* control, const Operand& q,
                                   const Operand& qd, const Operand& f, const Operand& to) {
  if (elements_.empty()) return f;
  elements_.eval(model, control, q, qd, f, to);
  return to;
}

// Rebuilt when the contacts changed.
const nova::Incidence* ParticleStep::contacts_of_particles(const Model& model,
                                                           const Contacts* contacts) {
  if (!contacts || !options_.contacts || contacts->soft_contact_max() == 0) return nullptr;
  const std::shared_ptr<Range>& range = contacts->soft_contact_particle.range();
  if (contacts_of_ && contacts_of_->table.range == range && nova::is_current(*contacts_of_, *range))
    return &contacts_of_;
  if (options_.refuse_overflow) {
    // Contacts are fixed while a capture records, so this host read is legal there too.
    ArrayObserver* observer = set_array_observer(nullptr);
    const bool overflowed = contacts->overflowed();
    set_array_observer(observer);
    require(!overflowed, ErrorKind::Runtime, "contacts: more contacts were found than the ",
            contacts->soft_contact_max(),
            " slots hold; make the pipeline with a larger soft_contact_max");
  }
  try {
    contacts_of_ = nova::make_incidence(nova::operand_of(contacts->soft_contact_particle),
                                        model.particle_count());
  } catch (const Error& error) {
    fail(error.kind(), "contacts.soft_contact_particle: ", error.what());
  }
  return &contacts_of_;
}

std::vector<ScratchSpec> ParticleStep::scratch() const {
  if (elements_.empty()) return {};
  // The forces on the particles with those of the elements.
  return {{DType::vec3, elements_.particle_count(), 1}};
}

void ParticleStep::begin(const Model& model, const Contacts* contacts, const char* function) {
  begin_model_reads(model, function);
  rows_.update(model, options_.static_contacts);
  contacts_of_particles(model, contacts);
}

void ParticleStep::run(const Model& model, SimState& in, SimState& out, const Control* control,
                       const Contacts* contacts, float dt) {
  const Operand q = nova::operand_of(in.particle_q), qd = nova::operand_of(in.particle_qd);
  const Operand applied = nova::operand_of(in.particle_f);
  const nova::Incidence* contacts_of = contacts_of_particles(model, contacts);
  // Recorded forces live in memory of the tape, so that the state's own array can be cleared and
  // reused; what a user reads there is a copy.
  const bool recording = nova::Tape::active() != nullptr;
  const auto target = [&] {
    if (!recording) return applied;
    Operand total = applied;
    total.range = Storage::allocate(applied.range->bytes(), model.device(), false)->range();
    return total;
  };
  Operand f = applied;
  if (!elements_.empty()) f = add_elements(model, control, q, qd, f, target());
  if (contacts_of || options_.static_contacts) {
    const Operand total = target();
    if (options_.static_contacts) {
      eval_static_contact_forces(model, rows_, q, qd, f, options_.static_contact_margin, total);
    } else {
      eval_soft_contact_forces(model, *contacts, *contacts_of, q, qd, f, total);
    }
    f = total;
  }
  if (f.range != applied.range) {
    nova::submit_copy(applied.range, f.range);
    const Operand recorded[] = {f};
    if (nova::Tape::active()->must_record(recorded))
      nova::Tape::active()->mark_copied(applied.range, "particle_f");
  }
  integrate_particles(model, q, qd, f, dt, nova::operand_of(out.particle_q),
                      nova::operand_of(out.particle_qd));
}

void ParticleStep::record(const Model& model, const SimState& in, SimState& out,
                          const StepInputs& inputs, StepScratch scratch) {
  const Operand q = nova::operand_of(in.particle_q), qd = nova::operand_of(in.particle_qd);
  const Operand q_out = nova::operand_of(out.particle_q),
                qd_out = nova::operand_of(out.particle_qd);
  const Operand f = elements_.empty() ? inputs.forces
                                      : add_elements(model, inputs.control, q, qd, inputs.forces,
                                                     nova::operand_of(scratch[0]));
  if (options_.static_contacts) {
    step_particles_with_static_contacts(model, rows_, q, qd, f, options_.static_contact_margin,
                                        inputs.dt, q_out, qd_out);
  } else if (const nova::Incidence* contacts_of = contacts_of_particles(model, inputs.contacts)) {
    step_particles(model, *inputs.contacts, *contacts_of, q, qd, f, inputs.dt, q_out, qd_out);
  } else {
    integrate_particles(model, q, qd, f, inputs.dt, q_out, qd_out);
  }
}

}  // namespace novaphy::diff
