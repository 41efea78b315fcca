// Bindings of SolverBase, SolverSemiImplicit, SleepConfig, eval_fk, eval_ik and eval_mimic.
#include "doc_dynamics.h"
#include "fast_step.h"
#include "fields.h"
#include "friction_laws.h"
#include "novaphy/dynamics/joint_coordinates.h"
#include "novaphy/dynamics/semi_implicit/solver_semi_implicit.h"

namespace novaphy::python {
namespace {

void bind_sleep(py::module_& m) {
  const SleepConfig d;
  py::class_<SleepConfig>(m, "SleepConfig", doc::kSleepConfig)
      .def(py::init([](float speed, float spin, float after) {
             const SleepConfig config{speed, spin, after};
             check_sleep("SleepConfig", config);
             return config;
           }),
           py::kw_only(), "speed"_a = d.speed, "spin"_a = d.spin, "after"_a = d.after)
      .def_readonly("speed", &SleepConfig::speed, "The bound of the center of mass's speed (m/s).")
      .def_readonly("spin", &SleepConfig::spin, "The bound of the angular speed (rad/s).")
      .def_readonly("after", &SleepConfig::after, "The time below both bounds (s).")
      .def("__eq__", [](const SleepConfig& a, const SleepConfig& b) { return a == b; })
      .def("__repr__", [](const SleepConfig& c) {
        return py::str("SleepConfig(speed={:.6g}, spin={:.6g}, after={:.6g})")
            .format(c.speed, c.spin, c.after);
      });
}

void bind_stable_dt(py::class_<SolverSemiImplicit, SolverBase>& solver) {
  solver.def(
      "stable_dt",
      [](const SolverSemiImplicit& s, const SimState& state, const Contacts* contacts) {
        return contacts != nullptr ? s.stable_dt(state, *contacts) : s.stable_dt(state);
      },
      "state"_a, "contacts"_a = py::none(), doc::kStableDt);
  solver.def_property_readonly(
      "sleep", [](const SolverSemiImplicit& s) { return s.options().sleep; },
      "The SleepConfig; None: no body sleeps.");
}

}  // namespace

void bind_dynamics(py::module_& m, py::module_& solvers) {
  BoundClass<SimState>::remember(m.attr("SimState"));
  BoundClass<Control>::remember(m.attr("Control"));
  BoundClass<Contacts>::remember(m.attr("Contacts"));
  py::class_<SolverBase> base(solvers, "SolverBase", doc::kSolverBase);
  base.def_property_readonly(
          "model", [](const SolverBase& s) { return std::const_pointer_cast<Model>(s.model()); },
          "The model. A solver reads the arrays and numbers of the model in every step.")
      .def("__repr__",
           [](const py::object& self) {
             const auto& solver = self.cast<const SolverBase&>();
             return std::string(py::str(py::type::of(self).attr("__name__"))) + "(" +
                    counts_text(solver.model()->counts()) + "device='" + solver.device().str() +
                    "')";
           })
      .def_property_readonly("device", &SolverBase::device, "The device of the model.")
      .def_property_readonly("supports_graph_capture", &SolverBase::supports_graph_capture,
                             "Whether step may be called in a capture.")
      .def("step", &SolverBase::step, "state_in"_a, "state_out"_a, "control"_a.none(true),
           "contacts"_a.none(true), "dt"_a, release_gil(), doc::kStep)
      .def(
          "notify_model_changed",
          [](SolverBase& s, int32_t flags) {
            s.notify_model_changed(static_cast<ModelFlags>(flags));
          },
          "flags"_a, doc::kNotify);
  GeneralStep::function = py::object(base.attr("step")).release().ptr();

  bind_sleep(m);
  const SemiImplicitOptions d;
  py::class_<SolverSemiImplicit, SolverBase> semi_implicit(solvers, "SolverSemiImplicit",
                                                           doc::kSemiImplicit);
  add_contact_laws(semi_implicit);
  semi_implicit
      .def(py::init([](const std::shared_ptr<Model>& model, float angular_damping,
                       const std::string& friction_law, std::optional<float> friction_smoothing,
                       float stick_ke, float joint_attach_ke, float joint_attach_kd,
                       bool enable_tri_contact, float particle_kf_bound,
                       const std::string& penalty_law, const std::optional<SleepConfig>& sleep) {
             return std::make_unique<SolverSemiImplicit>(
                 model, SemiImplicitOptions{.particle_kf_bound = particle_kf_bound,
                                            .angular_damping = angular_damping,
                                            .friction_law = to_friction_law(friction_law),
                                            .friction_smoothing = friction_smoothing,
                                            .penalty_law = to_penalty_law(penalty_law),
                                            .stick_ke = stick_ke,
                                            .joint_attach_ke = joint_attach_ke,
                                            .joint_attach_kd = joint_attach_kd,
                                            .enable_tri_contact = enable_tri_contact,
                                            .sleep = sleep});
           }),
           py::arg("model").none(false), py::kw_only(), "angular_damping"_a = d.angular_damping,
           "friction_law"_a = "viscous", "friction_smoothing"_a = py::none(),
           "stick_ke"_a = d.stick_ke, "joint_attach_ke"_a = d.joint_attach_ke,
           "joint_attach_kd"_a = d.joint_attach_kd, "enable_tri_contact"_a = d.enable_tri_contact,
           "particle_kf_bound"_a = d.particle_kf_bound, "penalty_law"_a = "sampled",
           "sleep"_a = py::none(), doc::kSemiImplicitInit)
      .def_property_readonly(
          "angular_damping",
          [](const SolverSemiImplicit& s) { return s.options().angular_damping; },
          "The damping of the angular velocity of bodies (1/s).")
      .def_property_readonly(
          "friction_smoothing",
          [](const SolverSemiImplicit& s) { return s.options().friction_smoothing; },
          "The slip below which friction is smooth (m/s). \"viscous\" and \"newton18\" do not use "
          "it.")
      .def_property_readonly(
          "particle_kf_bound",
          [](const SolverSemiImplicit& s) { return s.options().particle_kf_bound; },
          "The largest allowed kf dt / m for contacts of particles (1).")
      .def_property_readonly(
          "stick_ke", [](const SolverSemiImplicit& s) { return s.options().stick_ke; },
          "The tangential stiffness of each rigid contact (N/m).")
      .def_property_readonly(
          "joint_attach_ke",
          [](const SolverSemiImplicit& s) { return s.options().joint_attach_ke; },
          "The stiffness of the springs that hold joints together (N/m and N*m/rad).")
      .def_property_readonly(
          "joint_attach_kd",
          [](const SolverSemiImplicit& s) { return s.options().joint_attach_kd; },
          "The damping of the springs that hold joints together (N*s/m).")
      .def_property_readonly(
          "enable_tri_contact",
          [](const SolverSemiImplicit& s) { return s.options().enable_tri_contact; },
          "No effect, because contacts of particles with triangles are not supported.");
  bind_stable_dt(semi_implicit);
  add_fast_step(semi_implicit);
  m.def(
      "eval_fk",
      [](const Model& model, const Array& joint_q, const Array& joint_qd, SimState& state) {
        eval_fk(model, DeviceArray<float>(joint_q), DeviceArray<float>(joint_qd), state);
      },
      "model"_a, "joint_q"_a, "joint_qd"_a, "state"_a, doc::kEvalFk);
  m.def(
      "eval_mimic",
      [](const Model& model, const Array& joint_q, const Array& joint_qd) {
        eval_mimic(model, DeviceArray<float>(joint_q), DeviceArray<float>(joint_qd));
      },
      "model"_a, "joint_q"_a, "joint_qd"_a, doc::kEvalMimic);
  m.def(
      "eval_ik",
      [](const Model& model, const SimState& state, const Array& joint_q, const Array& joint_qd) {
        eval_ik(model, state, DeviceArray<float>(joint_q), DeviceArray<float>(joint_qd));
      },
      "model"_a, "state"_a, "joint_q"_a, "joint_qd"_a, doc::kEvalIk);
  bind_featherstone(m, solvers);
}

}  // namespace novaphy::python
