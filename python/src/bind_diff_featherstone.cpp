// Articulations on a tape.
#include <pybind11/stl.h>

#include "contact_options.h"
#include "fast_step.h"
#include "gradient_info.h"
#include "nova_types.h"
#include "novaphy/diff/diff_featherstone_solver.h"
#include "novaphy/diff/planar_arm.h"

namespace novaphy::python {

using diff::DiffFeatherstoneSolver;

namespace {

}  // namespace

void bind_diff_featherstone(py::module_& m, py::module_& solvers) {
  const FeatherstoneOptions d;
  py::class_<DiffFeatherstoneSolver, SolverBase> solver(
      solvers, "DiffFeatherstoneSolver",
      "SolverFeatherstone, with its bits, recorded on an active tape: one operation per step, with "
      "the exact adjoint and tangent. Exact gradients for joint_q, joint_qd, body_f, joint_f, "
      "targets, target_ke, target_kd, damping, armature, limits (bounds, ke, kd, effort, "
      "velocity), "
      "body_mass, body_com, body_inertia (its symmetric part) and gravity, where no limit or clamp "
      "is just reached; those of quaternions are tangent to the unit sphere. None for joint frames "
      "and axes: it raises. Contacts (pgs) and joint_friction have the gradient of the rows that "
      "are active, see gradient_info; shape_material_mu, _restitution, _ke and _kd too. A rollout "
      "may be captured. Models on devices as SolverFeatherstone; there step waits for the device.");
  solver
      .def(py::init([](const std::shared_ptr<Model>& model, float angular_damping,
                       bool implicit_drives, const std::optional<std::string>& contact,
                       const std::string& friction_cone, int pgs_iterations, float pgs_tolerance,
                       float pgs_erp, float pgs_slop, float pgs_cfm,
                       float max_depenetration_velocity, float restitution_threshold,
                       bool compliant_contacts, bool allow_unconverged,
                       const std::string& contact_gradient) {
             return std::make_unique<DiffFeatherstoneSolver>(
                 model,
                 FeatherstoneOptions{.angular_damping = angular_damping,
                                     .implicit_drives = implicit_drives,
                                     .contact = to_contact(contact),
                                     .friction_cone = to_cone(friction_cone),
                                     .pgs_iterations = pgs_iterations,
                                     .pgs_tolerance = pgs_tolerance,
                                     .pgs_erp = pgs_erp,
                                     .pgs_slop = pgs_slop,
                                     .pgs_cfm = pgs_cfm,
                                     .max_depenetration_velocity = max_depenetration_velocity,
                                     .restitution_threshold = restitution_threshold,
                                     .compliant_contacts = compliant_contacts},
                 allow_unconverged, to_contact_gradient("DiffFeatherstoneSolver", contact_gradient));
           }),
           py::arg("model").none(false), py::kw_only(), "angular_damping"_a = d.angular_damping,
           "implicit_drives"_a = d.implicit_drives, "contact"_a = "pgs", "friction_cone"_a = "cone",
           "pgs_iterations"_a = 1000, "pgs_tolerance"_a = d.pgs_tolerance, "pgs_erp"_a = d.pgs_erp,
           "pgs_slop"_a = d.pgs_slop, "pgs_cfm"_a = d.pgs_cfm,
           "max_depenetration_velocity"_a = d.max_depenetration_velocity,
           "restitution_threshold"_a = d.restitution_threshold,
           "compliant_contacts"_a = d.compliant_contacts, "allow_unconverged"_a = false,
           "contact_gradient"_a = "code",
           "As SolverFeatherstone. With contacts sweeps "
           "start from nothing and go on to pgs_tolerance, at most pgs_iterations times (1000 at "
           "least). backward and jvp raise novaphy.Error, with the step and the pair of shapes or "
           "the joint, where the last sweep of a step changed velocities by more than 1 % of its "
           "largest impulse (as a velocity), unless allow_unconverged. contact_gradient: \"code\", "
           "the "
           "derivative of the steps as they ran, in which a contact begins in the same step "
           "whatever "
           "the state; or \"motion\", in which the time of its begin moves with the state, so that "
           "a bounce has the sign and length that differences over many steps have (saltation "
           "matrix; CPU, outside of captures; second derivatives raise). States are the same. "
           "NotImplementedError for contact=\"penalty\", and for \"motion\" on a device or with "
           "compliant_contacts.")
      .def(
          "gradient_info",
          [](const DiffFeatherstoneSolver& s) {
            const ContactBranches b = s.branches();
            const auto margin = [](float x) {
              return x < ContactBranches::kNone ? py::object(py::float_(x)) : py::none();
            };
            return to_fields(
                s.gradient_info(),
                py::dict("contact_steps"_a = b.steps, "frozen_contacts"_a = b.held,
                         "unconverged_steps"_a = b.unconverged, "breaking"_a = b.breaking,
                         "sticking"_a = b.sticking, "sliding"_a = b.sliding,
                         "normal_margin"_a = margin(b.normal_margin),
                         "gap_margin"_a = margin(b.gap_margin),
                         "cone_margin"_a = margin(b.cone_margin),
                         "slip_margin"_a = margin(b.slip_margin)));
          },
          "GradientInfo of all steps since the last clear_gradient_info. Steps are exact of the "
          "code where points and normals of all contacts that push move as the search moves them: "
          "planes of the world with spheres, capsules, boxes, hulls or meshes, found from the "
          "state of the step as it is. Steps are frozen where frozen_contacts other contacts push. "
          "Their points stay in the frames of their bodies, their normals in the world. "
          "contact_steps: of the steps, those with contacts or dry friction; unconverged_steps: "
          "those whose gradient raises; breaking, sticking, sliding count contacts. Margins, None "
          "without a contact of the kind, to where the gradient jumps: normal_margin (m/s, the "
          "least normal impulse as a velocity, or speed of opening), gap_margin (m, to where an "
          "overlap begins or leaves pgs_slop, of contacts that push), cone_margin (1, the least "
          "distance of a sticking one from its cone), slip_margin (m/s, the least slip).")
      .def("clear_gradient_info", &DiffFeatherstoneSolver::clear_gradient_info,
           "Forgets what gradient_info counts.")
      .def_property_readonly(
          "angular_damping",
          [](const DiffFeatherstoneSolver& s) { return s.options().angular_damping; }, "1/s")
      .def_property_readonly(
          "implicit_drives",
          [](const DiffFeatherstoneSolver& s) { return s.options().implicit_drives; },
          "Drives of the end of the step.");
  add_fast_step(solver);

  m.def(
      "record_planar_2r_featherstone_step", &diff::record_planar_2r_featherstone_step, "model"_a,
      "state_in"_a, "control"_a.none(true), "q"_a, "qd"_a, "q_out"_a, "qd_out"_a, "dt"_a,
      "angular_damping"_a, release_gil(),
      "After SolverFeatherstone.step on an active tape: records that step of a planar arm of two "
      "links with the exact adjoint in closed form, from q, qd {2} to q_out, qd_out {2}. "
      "novaphy.Error, with the first condition that is not met: one articulation of two links on "
      "the world, REVOLUTE about +Y, without rotated frames, centers of mass at the bodies' "
      "origins, no drives, damping, friction, joint_f or body_f, gravity along -Z; and when q_out "
      "and qd_out are not what the closed form gives (a clamp, another angular_damping). Without a "
      "tape it only checks.");
  m.def("planar_2r_tip_loss", &diff::planar_2r_tip_loss, "model"_a, "q"_a, "target_x"_a,
        "target_z"_a, release_gil(),
        "|tip - target|^2 {1} (m^2) of the arm of record_planar_2r_featherstone_step at q {2}, in "
        "XOZ; the tip is as far behind the last center of mass as the joint before it. Exact.");
}

}  // namespace novaphy::python
