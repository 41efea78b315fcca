// Bindings of FeatherstoneAnalyticControlSensitivity: derivatives of an articulation by parameters
// of its control.
#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <optional>

#include "convert.h"
#include "doc_control_sensitivity.h"
#include "novaphy/dynamics/featherstone/control_sensitivity.h"
#include "part_bindings.h"

namespace novaphy::python {
namespace {

using Sensitivity = FeatherstoneAnalyticControlSensitivity;

py::array_t<float> to_matrix(const std::vector<float>& values, py::ssize_t rows) {
  py::array_t<float> to(
      {rows, static_cast<py::ssize_t>(values.size()) / std::max<py::ssize_t>(rows, 1)});
  std::copy(values.begin(), values.end(), to.mutable_data());
  return to;
}

// Reads an array {dofs, parameters}. ValueError: another shape.
std::vector<float> to_changes(const Sensitivity& s, py::handle value, const char* name) {
  using Rows = py::array_t<float, py::array::c_style | py::array::forcecast>;
  const Rows rows = Rows::ensure(value);
  if (!rows) {
    PyErr_Clear();
    fail(ErrorKind::Type, name, ": expected an array of numbers, got ", type_name(value));
  }
  const bool fits = rows.ndim() == 2 && rows.shape(0) == s.dof_count() &&
                    rows.shape(1) == s.options().parameter_count;
  std::string shape;
  for (py::ssize_t k = 0; k < rows.ndim(); ++k)
    shape += (k ? ", " : "") + std::to_string(rows.shape(k));
  require(fits, ErrorKind::Value, name, ": expected {", s.dof_count(), ", ",
          s.options().parameter_count, "} (dofs, parameters), got {", shape, "}");
  return {rows.data(), rows.data() + rows.size()};
}

ControlKind to_kind(const std::string& kind) {
  if (kind == "position") return ControlKind::Position;
  require(kind == "torque", ErrorKind::Value, "kind: expected \"position\" or \"torque\", got \"",
          kind, "\"");
  return ControlKind::Torque;
}

std::unique_ptr<Sensitivity> make(const std::shared_ptr<Model>& model, int32_t articulation,
                                  int32_t parameter_count, int32_t point_body,
                                  py::handle point_local, const std::string& kind,
                                  std::optional<bool> exact, bool contact_projection,
                                  const SolverFeatherstone* solver) {
  require(solver == nullptr || solver->model() == model, ErrorKind::Value,
          "solver: expected one of the model");
  return std::make_unique<Sensitivity>(
      model, ControlSensitivityOptions{
                 .articulation = articulation,
                 .parameter_count = parameter_count,
                 .point_body = point_body,
                 .point_local = to_vec3(point_local, "point_local"),
                 .kind = to_kind(kind),
                 .exact = exact.value_or(!contact_projection),
                 .contact_projection = contact_projection,
                 .solver = solver != nullptr ? solver->options() : FeatherstoneOptions{}});
}

}  // namespace

void bind_control_sensitivity(py::module_& solvers) {
  py::class_<Sensitivity>(solvers, "FeatherstoneAnalyticControlSensitivity", doc::kSensitivity)
      .def(py::init(&make), py::arg("model").none(false), "articulation"_a = 0, py::kw_only(),
           "parameter_count"_a, "point_body"_a, "point_local"_a = py::make_tuple(0.0f, 0.0f, 0.0f),
           "kind"_a = "position", "exact"_a = py::none(), "contact_projection"_a = false,
           py::arg("solver").none(true) = py::none(), doc::kSensitivityInit)
      .def("reset", &Sensitivity::reset, "state"_a,
           "Starts at a state and sets all derivatives to 0.")
      .def(
          "step",
          [](Sensitivity& s, const SimState& state_in, const SimState& state_out,
             const Control* control, float dt, py::handle dcontrol, py::handle dtarget_qd,
             const Contacts* contacts) {
            const std::vector<float> changes = to_changes(s, dcontrol, "dcontrol");
            std::vector<float> rates;
            if (!dtarget_qd.is_none()) rates = to_changes(s, dtarget_qd, "dtarget_qd");
            const ReleasedGil released;
            s.step(state_in, state_out, control, dt, changes, rates, contacts);
          },
          "state_in"_a, "state_out"_a, "control"_a.none(true), "dt"_a, "dcontrol"_a,
          "dtarget_qd"_a = py::none(), "contacts"_a.none(true) = py::none(), doc::kSensitivityStep)
      .def_property_readonly(
          "dq", [](const Sensitivity& s) { return to_matrix(s.dq(), s.dof_count()); },
          "The derivative of joint_q by the parameters {dofs, parameters}. The rows of a FREE root "
          "are its center of mass (m), then a small rotation vector (rad).")
      .def_property_readonly(
          "dqd", [](const Sensitivity& s) { return to_matrix(s.dqd(), s.dof_count()); },
          "The derivative of joint_qd by the parameters {dofs, parameters}.")
      .def_property_readonly(
          "point_jacobian", [](const Sensitivity& s) { return to_matrix(s.point_jacobian(), 3); },
          "The derivative of point() by the parameters {3, parameters}, in world axes.")
      .def_property_readonly(
          "point_velocity_jacobian",
          [](const Sensitivity& s) { return to_matrix(s.point_velocity_jacobian(), 3); },
          "The derivative of point_velocity() by the parameters {3, parameters}, in world axes.")
      .def(
          "point", [](const Sensitivity& s) { return to_tuple(s.point()); },
          "Returns the position of the point (m, world frame).")
      .def(
          "point_velocity", [](const Sensitivity& s) { return to_tuple(s.point_velocity()); },
          "Returns the velocity of the point (m/s, world frame).")
      .def_property_readonly("label", &Sensitivity::label,
                             "The label of the derivative: \"frozen\" or \"exact\".")
      .def_property_readonly(
          "parameter_count", [](const Sensitivity& s) { return s.options().parameter_count; },
          "The number of parameters.")
      .def_property_readonly("dof_count", &Sensitivity::dof_count,
                             "The number of dofs of the articulation.");
}

}  // namespace novaphy::python
