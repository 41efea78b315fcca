// The records of the gradients of DiffSemiImplicitSolver's steps, and of contacts that begin and
// end.
#include <utility>

#include "novaphy/collision/diff_soft_contact_trace.h"
#include "novaphy/core/error.h"
#include "novaphy/diff/diff_semi_implicit_solver.h"
#include "novaphy/dynamics/semi_implicit/diff_noted_springs.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"

namespace novaphy::diff {

namespace {
// `held`: MotionCounts::held of all steps, or null.
GradientInfo info_of(const Model& model, const GradientNotes& notes, const TouchList& touches,
                     DerivativeOf derivative, const char* held) {
  MotionCounts motion = touches.counts();
  if (held != nullptr) motion.held = held;
  GradientInfo info = novaphy::gradient_info(notes.counts(model), false,
                                             derivative == DerivativeOf::Code ? nullptr : &motion);
  info.steps_per_contact = steps_per_contact(model, notes.chain());
  return info;
}
}  // namespace

struct DiffSemiImplicitSolver::Witness : GradientWitness {
  std::shared_ptr<const Model> model;
  GradientNotes notes;
  TouchList touches;
  DerivativeOf derivative;
  const char *held, *unrecorded;
  Witness(const DiffSemiImplicitSolver& of)
      : model(of.model()),
        derivative(of.config_.contact_gradient),
        held(of.without_motion()),
        unrecorded(of.without_record()) {}
  GradientInfo info() const override { return info_of(*model, notes, touches, derivative, held); }
  MotionEvents events() const override { return touches.counts().events; }
  bool has_events() const override {
    return derivative != DerivativeOf::Code && held == nullptr && touches.held == nullptr;
  }
  const char* without_record() const override {
    const bool all_stored = !notes.chain().empty() || notes.counts(*model).steps == 0;
    return unrecorded == nullptr && !all_stored ? "DiffSemiImplicitSolver with checkpoints"
                                                : unrecorded;
  }
  void begin_record() const override { clear_gradients(notes.chain()); }
  void add_to(AdjointRecord& record) const override { add_springs(*model, notes.chain(), record); }
};

std::shared_ptr<DiffSemiImplicitSolver::Witness> DiffSemiImplicitSolver::witness() {
  return witness_on_tape(witness_, [this] { return std::make_shared<Witness>(*this); });
}

const char* DiffSemiImplicitSolver::without_motion() const {
  const bool is_auto = config_.contact_gradient == DerivativeOf::Auto;
  return !is_on_host(*model())                        ? "on a device"
         : config_.enable_static_contacts             ? "with enable_static_contacts"
         : config_.penalty_law != PenaltyLaw::Sampled ? "with penalty_law \"mean\""
         : is_auto && particles_.has_elements()       ? "with springs, cloth or soft bodies"
                                                      : nullptr;
}

const char* DiffSemiImplicitSolver::without_record() const {
  if (!is_on_host(*model())) return "DiffSemiImplicitSolver on a device";
  if (moves_particles()) return "DiffSemiImplicitSolver with particles";
  if (config_.enable_static_contacts) return "DiffSemiImplicitSolver with enable_static_contacts";
  if (config_.penalty_law != PenaltyLaw::Sampled)
    return "DiffSemiImplicitSolver with penalty_law \"mean\"";
  return nullptr;
}

GradientInfo DiffSemiImplicitSolver::gradient_info() const {
  return info_of(*model(), notes_, touches_, config_.contact_gradient, without_motion());
}

std::optional<TouchedStep> DiffSemiImplicitSolver::begin_touches(
    const SimState& in, SimState& out, const nova::Operand& forces,
    const nova::Operand& body_forces, const Control* control, const Contacts* contacts, float dt) {
  if (motion_ == nullptr || nova::Tape::active() == nullptr) return {};
  if (nova::current_capture()) {
    require(config_.contact_gradient == DerivativeOf::Auto, ErrorKind::NotImplemented,
            "DiffSemiImplicitSolver: contact_gradient: \"motion\" is not supported inside a "
            "ScopedCapture; use \"code\"");
    motion_->hold(in, out, "inside a ScopedCapture", touches_, witness()->touches);
    return {};
  }
  if (motion_->alternates(in)) {
    motion_->hold(in, out, "in loops of one solver that alternate", touches_, witness()->touches);
    return {};
  }
  return motion_->begin(*model(), in, out, forces, body_forces, control, contacts,
                        kf_rate(config_.particle_kf_bound, dt), dt, touches_, witness()->touches);
}

// Records a step on a tape for gradient_info.
void DiffSemiImplicitSolver::note_step(const SimState& in, const SimState& from,
                                       const SimState& out, const Contacts* contacts,
                                       const ContactTables& tables, const nova::Operand& wrench,
                                       float dt, bool keeps) {
  if (nova::Tape::active() == nullptr) return;
  const bool particles = moves_particles() && config_.enable_particle_contacts,
             bodies = moves_bodies() && config_.enable_rigid_contacts;
  const auto place = [this](const SimState& state) {
    return moves_bodies() ? state.body_q.range()->data() : state.particle_q.range()->data();
  };
  NotedStep step;
  step.start = place(in);
  step.end = place(out);
  step.q = from.particle_q;
  step.qd = from.particle_qd;
  step.body_q = from.body_q;
  step.body_qd = from.body_qd;
  step.contacts = notes_.handles(contacts);
  step.soft = particles;
  step.rigid = bodies;
  step.soft_contact_moves = tables.particles_move();
  step.rigid_contact_moves = tables.of_this_state();
  step.kf_rate = kf_rate(config_.particle_kf_bound, dt);
  step.smoothing = friction_smoothing_;
  step.dt = dt;
  if (config_.enable_static_contacts) {
    step.static_particles = particles;
    step.static_reach = config_.static_contact_margin;
    step.shapes_of = particles_.rows().pairs_of_particles();
    step.shape = particles_.rows().shape();
    if (bodies) step.plane_pairs = bodies_.plane_pairs().pairs();
  }
  NotedStep recorded = step;
  recorded.wrench = wrench;
  recorded.q_next = nova::operand_of(out.body_q);
  recorded.qd_next = nova::operand_of(out.body_qd);
  witness()->notes.add_to_all(*model(), std::move(recorded), keeps);
  notes_.add(*model(), std::move(step), keeps);
}

}  // namespace novaphy::diff
