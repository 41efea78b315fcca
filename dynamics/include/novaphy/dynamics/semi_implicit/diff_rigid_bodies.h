// Differentiable integration of rigid bodies with contacts on planes of the world. Compiled into
// novaphy::dynamics if nova is built.
//
// The gradient of each input:
//   body_q, body_qd, body_f    exact for the selected corners of boxes (rigid_plane_trace.h);
//                              body_q as seven free numbers
//   model: body_mass, body_inertia (through their stored inverses, which are derived), body_com,
//   gravity, shape_material_ke, _kd, _kf, _mu    exact
//   shape_transform, shape_scale, shape_margin, shape_gap, shape_material_ka, flags, angular
//   damping, smoothing, dt     none
#pragma once

#include <utility>

#include "novaphy/core/array_stamp.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/dynamics/export.h"
#include "novaphy/nova/kernel.h"

namespace novaphy::diff {

// The shape pairs that the operators below support, listed per body: an infinite plane of the world
// with a box, sphere or capsule of a body.
class NOVAPHY_DYNAMICS_API PlanePairs {
 public:
  // Updates the pairs if their source arrays were written. `with_contacts` false: no pairs, and
  // shape_contact_pairs is not read. ErrorKind::NotImplemented: an unsupported pair in
  // shape_contact_pairs (the message has its shapes), or a body of all worlds (-1) in a model of
  // several worlds. ErrorKind::Index: a world that does not exist.
  void update(const Model& model, bool with_contacts);
  const nova::Operand& pairs() const { return pairs_; }  // {n, 2}: plane, shape
  const nova::Incidence& pairs_of_bodies() const { return pairs_of_bodies_; }

 private:
  void find_pairs(const Model& model);
  ArrayStamp contact_pairs_, shape_body_, shape_type_, shape_scale_, body_world_;
  bool known_ = false, with_contacts_ = false;
  nova::Operand pairs_;
  nova::Incidence pairs_of_bodies_;
};

// Returns body_q and body_qd after one step of dt (s) of SolverSemiImplicit with the friction law
// huber. The kernel finds the contacts of shape_contact_pairs at the poses body_q, and then
// integrates (rigid_integrator_trace.h). The contacts of a pair are summed first, and the pairs are
// added to body_f in their order. Inputs: body_q {b, 7}, body_qd {b, 6}, body_f {b, 6}, packed
// float32 on the model's device (ErrorKind::Type, ErrorKind::Value). angular_damping (1/s) and
// friction_smoothing (m/s) are >= 0; smoothing 0 is the viscous law. newton_spin: see
// rigid_integrator_trace.h. ErrorKind::NotImplemented: an unsupported pair.
NOVAPHY_DYNAMICS_API std::pair<nova::Tensor, nova::Tensor>
integrate_rigid_bodies_with_static_contacts_generated(
    const Model& model, const nova::Tensor& body_q, const nova::Tensor& body_qd,
    const nova::Tensor& body_f, float angular_damping, float friction_smoothing, float dt,
    bool newton_spin = false);

// The parameters of step_rigid_bodies_with_static_contacts, which computes the same step into given
// memory, for solvers. `pairs` must be up to date.
struct RigidStepParameters {
  float angular_damping = 0.05f;    // 1/s
  float friction_smoothing = 0.1f;  // m/s
  float dt = 0.0f;                  // s
  bool newton_spin = false;         // rigid_integrator_trace.h
};
NOVAPHY_DYNAMICS_API void step_rigid_bodies_with_static_contacts(
    const Model& model, const PlanePairs& pairs, const nova::Operand& body_q,
    const nova::Operand& body_qd, const nova::Operand& body_f, const RigidStepParameters& numbers,
    const nova::Operand& q_out, const nova::Operand& qd_out);

}  // namespace novaphy::diff
