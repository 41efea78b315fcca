// Bindings of DiffFeatherstoneSolver, the planar arm and event_times.
#include <pybind11/stl.h>

#include "contact_options.h"
#include "doc_diff_featherstone.h"
#include "fast_step.h"
#include "gradient_info.h"
#include "nova_types.h"
#include "novaphy/diff/diff_featherstone_solver.h"
#include "novaphy/diff/event_times.h"
#include "novaphy/diff/planar_arm.h"

namespace novaphy::python {

using diff::DiffFeatherstoneSolver;

namespace {

GradientInfoFields info_of(const DiffFeatherstoneSolver& s) {
  const ContactBranches b = s.branches();
  const auto margin = [](float x) {
    return x < ContactBranches::kNone ? py::object(py::float_(x)) : py::none();
  };
  return to_fields(
      s.gradient_info(),
      py::dict("contact_steps"_a = b.steps, "frozen_contacts"_a = b.held,
               "unconverged_steps"_a = b.unconverged, "breaking"_a = b.breaking,
               "sticking"_a = b.sticking, "sliding"_a = b.sliding,
               "normal_margin"_a = margin(b.normal_margin), "gap_margin"_a = margin(b.gap_margin),
               "cone_margin"_a = margin(b.cone_margin), "slip_margin"_a = margin(b.slip_margin)));
}

}  // namespace

void bind_diff_featherstone(py::module_& m, py::module_& solvers) {
  const FeatherstoneOptions d;
  py::class_<DiffFeatherstoneSolver, SolverBase> solver(solvers, "DiffFeatherstoneSolver",
                                                        doc::kDiffFeatherstone);
  solver
      .def(py::init([](const std::shared_ptr<Model>& model, float angular_damping,
                       bool implicit_drives, const std::optional<std::string>& contact,
                       const std::string& friction_cone, int pgs_iterations, float pgs_tolerance,
                       float pgs_erp, float pgs_slop, float pgs_cfm,
                       float max_depenetration_velocity, float restitution_threshold,
                       bool compliant_contacts, bool allow_unconverged,
                       const std::string& contact_gradient, const std::string& joint_limits,
                       float joint_limit_restitution) {
             return std::make_unique<DiffFeatherstoneSolver>(
                 model,
                 FeatherstoneOptions{
                     .angular_damping = angular_damping,
                     .implicit_drives = implicit_drives,
                     .joint_limits = to_limits("DiffFeatherstoneSolver", joint_limits),
                     .joint_limit_restitution = joint_limit_restitution,
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
                 allow_unconverged,
                 to_contact_gradient("DiffFeatherstoneSolver", contact_gradient));
           }),
           py::arg("model").none(false), py::kw_only(), "angular_damping"_a = d.angular_damping,
           "implicit_drives"_a = d.implicit_drives, "contact"_a = "pgs", "friction_cone"_a = "cone",
           "pgs_iterations"_a = 1000, "pgs_tolerance"_a = d.pgs_tolerance, "pgs_erp"_a = d.pgs_erp,
           "pgs_slop"_a = d.pgs_slop, "pgs_cfm"_a = d.pgs_cfm,
           "max_depenetration_velocity"_a = d.max_depenetration_velocity,
           "restitution_threshold"_a = d.restitution_threshold,
           "compliant_contacts"_a = d.compliant_contacts, "allow_unconverged"_a = false,
           "contact_gradient"_a = "auto", "joint_limits"_a = "spring",
           "joint_limit_restitution"_a = d.joint_limit_restitution, doc::kDiffFeatherstoneInit)
      .def("gradient_info", &info_of, doc::kFeatherstoneInfo)
      .def("clear_gradient_info", &DiffFeatherstoneSolver::clear_gradient_info,
           "Resets the counts of gradient_info.")
      .def_property_readonly(
          "angular_damping",
          [](const DiffFeatherstoneSolver& s) { return s.options().angular_damping; },
          "The damping of angular dofs (1/s).")
      .def_property_readonly(
          "implicit_drives",
          [](const DiffFeatherstoneSolver& s) { return s.options().implicit_drives; },
          "Whether drives, limits and damping are evaluated at the end of the step.");
  add_fast_step(solver);

  m.def("record_planar_2r_featherstone_step", &diff::record_planar_2r_featherstone_step, "model"_a,
        "state_in"_a, "control"_a.none(true), "q"_a, "qd"_a, "q_out"_a, "qd_out"_a, "dt"_a,
        "angular_damping"_a, release_gil(), doc::kPlanarArm);
  m.def("planar_2r_tip_loss", &diff::planar_2r_tip_loss, "model"_a, "q"_a, "target_x"_a,
        "target_z"_a, release_gil(), doc::kPlanarTipLoss);
}

void bind_event_times(py::module_& m) {
  m.def("event_times", &diff::event_times, "trajectory"_a, release_gil(),
        "Returns the times {events} (s) at which contacts and joint limits begin, in the order of "
        "GradientInfo.event_list. The time 0 is the first step that filled the trajectory. The "
        "active tape records the call. The solver needs gradients of the motion.\n\nAn event "
        "in step k has the time t_k + d / |J v|, with the gap d, its derivative J by the "
        "positions, and the joint rates v. The derivative of the time by the positions of state k "
        "is J / |J v| (saltation matrix). The number and the order of events count as constants. "
        "Without events the result is {0}.\n\nValueError: no tape is active, or the tape has no "
        "steps of such a solver.\nNotImplementedError: the trajectory has checkpoints.");
}

}  // namespace novaphy::python
