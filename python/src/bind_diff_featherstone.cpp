// Articulations on a tape.
#include "fast_step.h"
#include "nova_types.h"
#include "novaphy/diff/diff_featherstone_solver.h"
#include "novaphy/diff/planar_arm.h"

namespace novaphy::python {

using diff::DiffFeatherstoneSolver;

void bind_diff_featherstone(py::module_& m, py::module_& solvers) {
  const FeatherstoneOptions d;
  py::class_<DiffFeatherstoneSolver, SolverBase> solver(
      solvers, "DiffFeatherstoneSolver",
      "SolverFeatherstone, with its bits, recorded on an active tape: one operation per step, with "
      "the exact adjoint and tangent. Exact gradients for joint_q, joint_qd, body_f, joint_f, "
      "targets, target_ke, target_kd, damping, armature, limits (bounds, ke, kd, effort, "
      "velocity), "
      "body_mass, body_com and body_inertia (its symmetric part), where no limit or clamp is just "
      "reached; those of quaternions are tangent to the unit sphere. None for gravity, joint "
      "frames "
      "and axes: it raises.");
  solver
      .def(py::init([](const std::shared_ptr<Model>& model, float angular_damping,
                       bool implicit_drives) {
             return std::make_unique<DiffFeatherstoneSolver>(
                 model, FeatherstoneOptions{.angular_damping = angular_damping,
                                            .implicit_drives = implicit_drives});
           }),
           py::arg("model").none(false), py::kw_only(), "angular_damping"_a = d.angular_damping,
           "implicit_drives"_a = d.implicit_drives, "As SolverFeatherstone.")
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
      "the world, REVOLUTE about +Y, without rotated frames, centres of mass at the bodies' "
      "origins, no drives, damping, friction, joint_f or body_f, gravity along -Z; and when q_out "
      "and qd_out are not what the closed form gives (a clamp, another angular_damping). Without a "
        "tape it only checks.");
  m.def("planar_2r_tip_loss", &diff::planar_2r_tip_loss, "model"_a, "q"_a, "target_x"_a,
        "target_z"_a, release_gil(),
        "|tip - target|^2 {1} (m^2) of the arm of record_planar_2r_featherstone_step at q {2}, in "
        "XOZ; the tip is as far behind the last centre of mass as the joint before it. Exact.");
}

}  // namespace novaphy::python
