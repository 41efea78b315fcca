// The record of the gradients of DiffSemiImplicitSolver's steps, and of the events that move in
// time.
#include <utility>

#include "novaphy/collision/diff_soft_contact_trace.h"
#include "novaphy/core/error.h"
#include "novaphy/diff/diff_semi_implicit_solver.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"

namespace novaphy::diff {

namespace {
GradientInfo info_of(const Model& model, const GradientNotes& notes, const TouchList& touches,
                     bool moves) {
  const MotionCounts motion = touches.counts();
  return novaphy::gradient_info(notes.counts(model), false, moves ? &motion : nullptr);
}
}  // namespace

struct DiffSemiImplicitSolver::Witness : GradientWitness {
  std::shared_ptr<const Model> model;
  GradientNotes notes;
  TouchList touches;
  bool moves;
  Witness(std::shared_ptr<const Model> of, bool motion) : model(std::move(of)), moves(motion) {}
  GradientInfo info() const override { return info_of(*model, notes, touches, moves); }
  MotionEvents events() const override { return touches.counts().events; }
  bool has_events() const override { return moves; }
  const char* without_record() const override { return "DiffSemiImplicitSolver"; }
};

std::shared_ptr<DiffSemiImplicitSolver::Witness> DiffSemiImplicitSolver::witness() {
  return witness_on_tape(witness_,
                         [this] { return std::make_shared<Witness>(model(), motion_ != nullptr); });
}

GradientInfo DiffSemiImplicitSolver::gradient_info() const {
  return info_of(*model(), notes_, touches_, motion_ != nullptr);
}

std::optional<TouchedStep> DiffSemiImplicitSolver::begin_touches(
    const SimState& in, SimState& out, const nova::Operand& forces,
    const nova::Operand& body_forces, const Control* control, const Contacts* contacts, float dt) {
  if (motion_ == nullptr || nova::Tape::active() == nullptr) return {};
  require(!nova::current_capture(), ErrorKind::NotImplemented,
          "DiffSemiImplicitSolver: contact_gradient: \"motion\" is not there inside a "
          "ScopedCapture; use \"code\"");
  return motion_->begin(*model(), in, out, forces, body_forces, control, contacts,
                        kf_rate(config_.particle_kf_bound, dt), dt, touches_, witness()->touches);
}

// Notes a step on a tape for gradient_info.
void DiffSemiImplicitSolver::note_step(const SimState& in, const SimState& out,
                                       const Contacts* contacts, const ContactTables& tables,
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
  step.q = in.particle_q;
  step.qd = in.particle_qd;
  step.body_q = in.body_q;
  step.body_qd = in.body_qd;
  step.contacts = notes_.handles(contacts);
  step.soft = particles;
  step.rigid = bodies;
  step.soft_follow = tables.particles_follow();
  step.rigid_follow = tables.of_this_state();
  step.kf_rate = kf_rate(config_.particle_kf_bound, dt);
  step.smoothing = friction_smoothing_;
  if (config_.enable_static_contacts) {
    step.static_particles = particles;
    step.static_reach = config_.static_contact_margin;
    step.shapes_of = particles_.rows().pairs_of_particles();
    step.shape = particles_.rows().shape();
    if (bodies) step.plane_pairs = bodies_.plane_pairs().pairs();
  }
  witness()->notes.add_to_all(*model(), step, keeps);
  notes_.add(*model(), std::move(step), keeps);
}

}  // namespace novaphy::diff
