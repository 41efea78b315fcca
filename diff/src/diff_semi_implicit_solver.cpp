#include "novaphy/diff/diff_semi_implicit_solver.h"

#include <cmath>

#include "novaphy/collision/diff_soft_contacts.h"
#include "novaphy/core/error.h"
#include "novaphy/core/parallel.h"
#include "novaphy/dynamics/semi_implicit/diff_particles.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"

namespace novaphy::diff {

using nova::Operand;

DiffSemiImplicitSolver::DiffSemiImplicitSolver(std::shared_ptr<const Model> model,
                                               const DiffSolverConfig& config)
    : SolverBase(std::move(model)), config_(config) {
  require(!config.enable_tetrahedra, ErrorKind::NotImplemented,
          "DiffSolverConfig, enable_tetrahedra: not covered yet");
  require(!config.enable_triangles, ErrorKind::NotImplemented,
          "DiffSolverConfig, enable_triangles: not covered yet");
  const ModelCounts& counts = this->model()->counts();
  require(!config.strict || counts.body_count == 0, ErrorKind::NotImplemented,
          "DiffSemiImplicitSolver: rigid bodies are not covered yet");
  require(this->model()->gravity.rows() == 1, ErrorKind::NotImplemented,
          "DiffSemiImplicitSolver: models of several worlds are not covered");
}

// Rebuilt when the contacts changed.
const nova::Incidence* DiffSemiImplicitSolver::contacts_of_particles(const Contacts* contacts) {
  if (!contacts || !config_.enable_particle_contacts || contacts->soft_contact_max() == 0)
    return nullptr;
  const std::shared_ptr<Range>& range = contacts->soft_contact_particle.range();
  if (contacts_of_ && contacts_of_->table.range == range && nova::is_current(*contacts_of_, *range))
    return &contacts_of_;
  if (config_.strict) {
    // Contacts are fixed while a capture records, so this host read is legal there too.
    ArrayObserver* observer = set_array_observer(nullptr);
    const bool overflowed = contacts->overflowed();
    set_array_observer(observer);
    require(!overflowed, ErrorKind::Runtime, "contacts: more contacts were found than the ",
            contacts->soft_contact_max(),
            " slots hold; make the pipeline with a larger soft_contact_max");
  }
  contacts_of_ = nova::make_incidence({range, contacts->soft_contact_max(), 1, nova::ir::Type::I32},
                                      model()->particle_count());
  return &contacts_of_;
}

void DiffSemiImplicitSolver::step(SimState& state_in, SimState& state_out, const Control* control,
                                  const Contacts* contacts, float dt) {
  require(!nova::current_capture(), ErrorKind::Runtime,
          "DiffSemiImplicitSolver.step inside a ScopedCapture: capture rollout instead "
          "(supports_graph_capture is False)");
  check_step("DiffSemiImplicitSolver.step", state_in, state_out, control, contacts, dt);
  if (!config_.enable_particles || model()->particle_count() == 0) return;
  const Operand q = nova::operand_of(state_in.particle_q),
                qd = nova::operand_of(state_in.particle_qd);
  Operand f = nova::operand_of(state_in.particle_f);
  if (const nova::Incidence* contacts_of = contacts_of_particles(contacts)) {
    nova::Tape* tape = nova::Tape::active();
    const Operand operands[] = {q, qd, f};
    if (tape && tape->must_record(operands)) {
      // The recorded force lives in memory of the tape, so that the state's own array can be
      // cleared and reused; what a user reads there is a copy.
      Operand total = f;
      total.range = Storage::allocate(f.range->bytes(), device(), false)->range();
      eval_soft_contact_forces(*model(), *contacts, *contacts_of, q, qd, f, total);
      nova::submit_copy(f.range, total.range);
      tape->mark_copied(f.range, "particle_f");
      f = total;
    } else {
      eval_soft_contact_forces(*model(), *contacts, *contacts_of, q, qd, f, f);
    }
  }
  integrate_particles(*model(), q, qd, f, dt, nova::operand_of(state_out.particle_q),
                      nova::operand_of(state_out.particle_qd));
}

void DiffSemiImplicitSolver::rollout(Trajectory& trajectory, const Control* control,
                                     const Contacts* contacts, float dt) {
  if (trajectory.steps() == 0 || !config_.enable_particles || model()->particle_count() == 0)
    return;
  require(trajectory.model() == model(), ErrorKind::Value,
          "DiffSemiImplicitSolver.rollout, trajectory: it belongs to "
          "another model");
  require(std::isfinite(dt) && dt > 0.0f, ErrorKind::Value,
          "DiffSemiImplicitSolver.rollout, dt: expected a finite time step > 0, got ", dt);
  require(!control || control->model_id() == model()->id(), ErrorKind::Value,
          "DiffSemiImplicitSolver.rollout, control: it belongs to another model");
  require(!contacts || contacts->model_id() == model()->id(), ErrorKind::Value,
          "DiffSemiImplicitSolver.rollout, contacts: they belong to another model");
  const nova::Incidence* contacts_of = contacts_of_particles(contacts);
  const Operand f = nova::operand_of(trajectory.particle_f());
  constexpr int32_t kStepsPerInterruptCheck = 32;
  constexpr int32_t kLargeParticleCount =
      2048;  // from here on the steps share the cache block by block
  nova::DeferredScope deferred(model()->particle_count() >= kLargeParticleCount);
  for (int32_t t = 0; t < trajectory.steps(); ++t) {
    if (t % kStepsPerInterruptCheck == 0) check_interrupt();
    const SimState& now = trajectory.state(t);
    const SimState& next = trajectory.state(t + 1);
    const Operand q = nova::operand_of(now.particle_q), qd = nova::operand_of(now.particle_qd);
    const Operand q_out = nova::operand_of(next.particle_q),
                  qd_out = nova::operand_of(next.particle_qd);
    if (contacts_of) {
      step_particles(*model(), *contacts, *contacts_of, q, qd, f, dt, q_out, qd_out);
    } else {
      integrate_particles(*model(), q, qd, f, dt, q_out, qd_out);
    }
  }
  deferred.flush();
}

}  // namespace novaphy::diff
