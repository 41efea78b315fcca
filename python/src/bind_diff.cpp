// Views, differentiable operators, losses, Trajectory and the differentiable solver.
#include <algorithm>
#include <charconv>
#include <optional>
#include <span>

#include "doc_diff.h"
#include "fast_step.h"
#include "friction_laws.h"
#include "gradient_info.h"
#include "nova_types.h"
#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/collision/diff_soft_contacts.h"
#include "novaphy/diff/diff_semi_implicit_solver.h"
#include "novaphy/diff/losses.h"
#include "novaphy/diff/rigid_losses.h"
#include "novaphy/diff/tensor_views.h"
#include "novaphy/diff/trajectory.h"
#include "novaphy/dynamics/semi_implicit/contact_gradients.h"
#include "novaphy/dynamics/semi_implicit/diff_elements.h"
#include "novaphy/dynamics/semi_implicit/diff_particles.h"
#include "novaphy/dynamics/semi_implicit/diff_rigid_bodies.h"
#include "novaphy/nova/ops.h"
#include "part_bindings.h"
#include "pickle.h"

namespace novaphy::python {

using nova::Tensor;

namespace {

using diff::DiffSemiImplicitSolver;
using diff::DiffSolverConfig;
using diff::Trajectory;

#define NOVAPHY_BIND_STATE_VIEW(field)                                                      \
  m.def("state_" #field "_tensor", &diff::state_##field##_tensor, "state"_a,                \
        "requires_grad"_a = false,                                                          \
        "Returns state." #field                                                             \
        " as a Tensor over the same memory, the same object in every call. requires_grad: " \
        "True makes the Tensor a leaf; False changes nothing.");
#define NOVAPHY_BIND_MODEL_VIEW(field)                                                      \
  m.def("model_" #field "_tensor", &diff::model_##field##_tensor, "model"_a,                \
        "requires_grad"_a = false,                                                          \
        "Returns model." #field                                                             \
        " as a Tensor over the same memory, the same object in every call. requires_grad: " \
        "True makes the Tensor a leaf; False changes nothing.");

#define NOVAPHY_BIND_ELEMENT_VIEW(name, field)                                              \
  m.def("model_" #name "_tensor", &diff::model_##name##_tensor, "model"_a,                  \
        "requires_grad"_a = false,                                                          \
        "Returns model." #field                                                             \
        " as a Tensor over the same memory, the same object in every call. requires_grad: " \
        "True makes the Tensor a leaf; False changes nothing.");
#define NOVAPHY_BIND_CONTROL_VIEW(name, field)                                              \
  m.def("control_" #name "_tensor", &diff::control_##name##_tensor, "control"_a,            \
        "requires_grad"_a = false,                                                          \
        "Returns control." #field                                                           \
        " as a Tensor over the same memory, the same object in every call. requires_grad: " \
        "True makes the Tensor a leaf; False changes nothing.");

void bind_views(py::module_& m) {
  NOVAPHY_STATE_VIEWS(NOVAPHY_BIND_STATE_VIEW)
  NOVAPHY_MODEL_VIEWS(NOVAPHY_BIND_MODEL_VIEW)
  NOVAPHY_ELEMENT_VIEWS(NOVAPHY_BIND_ELEMENT_VIEW)
  NOVAPHY_CONTROL_VIEWS(NOVAPHY_BIND_CONTROL_VIEW)
  m.def("update_inverse_mass", &diff::update_inverse_mass, "model"_a, release_gil(),
        "Sets model.particle_inv_mass to 1 / particle_mass (1/kg), or to 0 for the mass 0. A tape "
        "does not record the call.");
}

void bind_operators(py::module_& m) {
  m.def(
      "rigid_contact_gradient_labels",
      [](const Model& model, const SimState& state, const Contacts& contacts) {
        py::list labels;
        for (const bool exact : exact_contact_gradients(model, state, contacts))
          labels.append(exact ? "exact" : "frozen");
        return labels;
      },
      "model"_a, "state"_a, "contacts"_a, doc::kRowLabels);
  m.def("eval_static_particle_shape_contact_forces_generated",
        &diff::eval_static_particle_shape_contact_forces_generated, "model"_a, "particle_q"_a,
        "particle_qd"_a, "particle_f"_a, "soft_contact_margin"_a = 0.0f, release_gil(),
        doc::kStaticForces);
  m.def("integrate_particles_generated", &diff::integrate_particles_generated, "model"_a,
        "particle_q"_a, "particle_qd"_a, "particle_f"_a, "dt"_a, release_gil(), doc::kParticleStep);
  m.def("integrate_particles_with_static_contacts_generated",
        &diff::integrate_particles_with_static_contacts_generated, "model"_a, "particle_q"_a,
        "particle_qd"_a, "particle_f"_a, "soft_contact_margin"_a, "dt"_a, release_gil(),
        "Computes eval_static_particle_shape_contact_forces_generated and "
        "integrate_particles_generated in one kernel. Returns (q, qd), as two calls.");
  m.def("integrate_rigid_bodies_with_static_contacts_generated",
        &diff::integrate_rigid_bodies_with_static_contacts_generated, "model"_a, "body_q"_a,
        "body_qd"_a, "body_f"_a, "angular_damping"_a, "friction_smoothing"_a, "dt"_a,
        "newton_spin"_a = false, release_gil(), doc::kRigidStep);
  m.def("body_twist_from_omega_generated", &diff::body_twist_from_omega_generated, "omega"_a,
        "linear_x"_a, "linear_y"_a, "linear_z"_a, release_gil(),
        "Returns velocities {b, 6} of bodies: linear (m/s), then the rows of omega {b, 3} "
        "(rad/s).");
  m.def(
      "rigid_orientation_velocity_loss_generated",
      [](const Tensor& body_q, const Tensor& body_qd, int64_t body_index, py::handle local_axis_a,
         py::handle target_axis_a, py::handle local_axis_b, py::handle target_axis_b,
         float axis_weight_a, float axis_weight_b, float target_height, float height_weight,
         float linear_velocity_weight, float angular_velocity_weight) {
        return diff::rigid_orientation_velocity_loss_generated(
            body_q, body_qd, body_index, to_vec3(local_axis_a, "local_axis_a"),
            to_vec3(target_axis_a, "target_axis_a"), to_vec3(local_axis_b, "local_axis_b"),
            to_vec3(target_axis_b, "target_axis_b"),
            {.axis_weight_a = axis_weight_a,
             .axis_weight_b = axis_weight_b,
             .target_height = target_height,
             .height_weight = height_weight,
             .linear_velocity_weight = linear_velocity_weight,
             .angular_velocity_weight = angular_velocity_weight});
      },
      "body_q"_a, "body_qd"_a, "body_index"_a, "local_axis_a"_a, "target_axis_a"_a,
      "local_axis_b"_a, "target_axis_b"_a, py::kw_only(), "axis_weight_a"_a = 1.0f,
      "axis_weight_b"_a = 1.0f, "target_height"_a = 0.0f, "height_weight"_a = 0.0f,
      "linear_velocity_weight"_a = 0.0f, "angular_velocity_weight"_a = 0.0f, doc::kOrientationLoss);
  m.def("assign_tet_materials_generated", &diff::assign_tet_materials_generated,
        "material_params"_a, "base_tet_materials"_a, "tet_count"_a, release_gil(),
        "Returns tet materials {tet_count, 3}: k_mu and k_lambda (Pa) from material_params, {2} or "
        "{2 * tet_count}, and k_damp from base_tet_materials {tet_count, 3}. Gradients are exact.");
  m.def("eval_tetrahedra_forces_generated", &diff::eval_tetrahedra_forces_generated, "model"_a,
        "particle_q"_a, "particle_qd"_a, "particle_f"_a, "tet_activations"_a, "tet_materials"_a,
        release_gil(),
        "Returns particle_f {n, 3} plus the forces (N) of all tetrahedra, for activations {k} and "
        "materials {k, 3} (k_mu, k_lambda, k_damp). Gradients are exact for all inputs.");
  m.def("eval_triangle_forces_generated", &diff::eval_triangle_forces_generated, "model"_a,
        "particle_q"_a, "particle_qd"_a, "particle_f"_a, "tri_activations"_a, "tri_materials"_a,
        release_gil(), doc::kTrianglesForces);
  m.def("eval_spring_forces_generated", &diff::eval_spring_forces_generated, "model"_a,
        "particle_q"_a, "particle_qd"_a, "particle_f"_a, "spring_stiffness"_a, "spring_damping"_a,
        "spring_rest_length"_a, release_gil(), doc::kSpringsForces);
  m.def("eval_bending_forces_generated", &diff::eval_bending_forces_generated, "model"_a,
        "particle_q"_a, "particle_qd"_a, "particle_f"_a, "edge_materials"_a, "edge_rest_angle"_a,
        release_gil(),
        "Returns particle_f {n, 3} plus the forces (N) of all bending edges, for materials {e, 2} "
        "(edge_ke, edge_kd) and rest angles {e} (rad). Gradients are exact for all inputs.");
  m.def("particle_point_loss_generated", &diff::particle_point_loss_generated, "particle_q"_a,
        "particle_index"_a, "target_x"_a, "target_y"_a, "target_z"_a, release_gil(),
        "Returns |q[particle_index] - target|^2 {1} (m^2). IndexError: the particle does not "
        "exist.");
  m.def("particle_centroid_generated", &diff::particle_centroid_generated, "particle_q"_a,
        release_gil(), "Returns the unweighted mean position {1, 3} (m) of all particles.");
  m.def("vec3_point_loss_generated", &diff::vec3_point_loss_generated, "point"_a, "target_x"_a,
        "target_y"_a, "target_z"_a, release_gil(),
        "Returns |point - target|^2 {1} (m^2) for a point {1, 3} or {3}.");
  m.def("clamp_f32_generated", &diff::clamp_f32_generated, "x"_a, "lower"_a, "upper"_a,
        release_gil(),
        "Limits x to [lower, upper]. The gradient is 1 inside and at the bounds, 0 outside.");
}

// Returns a field of all kept states as one tensor, such as {kept, n, 3}; {n, 3} for applied
// forces.
Tensor whole(const Trajectory& t, FieldRole role, const Array& array) {
  if (role == FieldRole::Applied) return Tensor::view(array);
  nova::Shape shape = array.shape();
  shape[0] /= t.stored_count();
  shape.insert(shape.begin(), t.stored_count());
  return {array.range(), std::move(shape), Tensor::view(array).dtype()};
}

// Returns the number of bytes of a text such as "64MiB".
uint64_t byte_count(const std::string& text) {
  uint64_t number = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  const std::string unit(end, text.data() + text.size());
  const int shift = unit == "KiB" ? 10 : unit == "MiB" ? 20 : unit == "GiB" ? 30 : -1;
  require(
      error == std::errc() && shift > 0 && number > 0 && number < (uint64_t{1} << 33),
      ErrorKind::Value,
      "Trajectory, checkpoint: expected an interval or memory as \"64MiB\" (KiB, MiB, GiB), got \"",
      text, "\"");
  return number << shift;
}

int32_t checkpoint_interval(const Model& model, int32_t steps, const py::object& checkpoint) {
  if (checkpoint.is_none()) return 1;
  if (py::isinstance<py::str>(checkpoint))
    return diff::checkpoint_interval_for(model, steps, byte_count(checkpoint.cast<std::string>()));
  return to_int32(checkpoint, "Trajectory, checkpoint");
}

void bind_trajectory(py::module_& m) {
  py::class_<Trajectory> c(m, "Trajectory", py::dynamic_attr(), doc::kTrajectory);
  c.def(py::init([](const std::shared_ptr<Model>& model, int32_t steps, bool requires_grad,
                    const py::object& checkpoint) {
          return std::make_unique<Trajectory>(model, steps, requires_grad,
                                              checkpoint_interval(*model, steps, checkpoint));
        }),
        py::arg("model").none(false), "steps"_a, "requires_grad"_a = true,
        "checkpoint"_a = py::none(), doc::kTrajectoryInit)
      .def("__len__", [](const Trajectory& t) { return t.steps() + 1; })
      .def("__repr__",
           [](const Trajectory& t) {
             const int32_t interval = t.checkpoint_interval();
             return "Trajectory(steps=" + std::to_string(t.steps()) + ", " +
                    (interval > 1 ? "checkpoint_interval=" + std::to_string(interval) + ", " : "") +
                    counts_text(t.model()->counts()) + "device='" + t.model()->device().str() +
                    "')";
           })
      .def("__iter__",
           [](const py::object& self) {
             py::list states;
             const auto& trajectory = self.cast<Trajectory&>();
             for (int32_t t = 0; t <= trajectory.steps(); ++t)
               if (trajectory.keeps(t)) states.append(self[py::int_(t)]);
             return py::iter(states);
           })
      .def(
          "__getitem__",
          [](Trajectory& t, int32_t k) -> SimState& {
            return t.state(k < 0 ? k + t.steps() + 1 : k);
          },
          "t"_a, py::return_value_policy::reference_internal,
          "Returns state t. IndexError: t is out of range. RuntimeError: state t is not stored.")
      .def("recompute", &Trajectory::recompute, "t"_a, release_gil(), doc::kRecompute)
      .def_property_readonly("checkpoint_interval", &Trajectory::checkpoint_interval,
                             "The number of steps between stored states; 1: all are stored.")
      .def_property_readonly(
          "kept_steps",
          [](const Trajectory& t) {
            py::list kept;
            for (int32_t k = 0; k <= t.steps(); ++k)
              if (t.keeps(k)) kept.append(k);
            return kept;
          },
          "The indices of the stored states, in the order of the rows of arrays like particle_q.")
      .def_property_readonly("steps", &Trajectory::steps,
                             "The number of steps, which is the number of states minus 1.")
      .def_property_readonly(
          "model", [](const Trajectory& t) { return std::const_pointer_cast<Model>(t.model()); },
          "The model of the trajectory.");
#define NOVAPHY_BIND_WHOLE(name, ...)                                                             \
  {                                                                                               \
    const FieldInfo info = NOVAPHY_FIELD_INFO(name, __VA_ARGS__);                                 \
    const std::string doc =                                                                       \
        (info.role == FieldRole::Applied ? "One array, which all states share: "                  \
                                         : "The array {kept, ...} of all kept states: ") +        \
        std::string(info.doc) + (info.unit.empty() ? "." : " (" + std::string(info.unit) + ")."); \
    c.def_property_readonly(                                                                      \
        #name,                                                                                    \
        [role = info.role](const Trajectory& t) { return whole(t, role, t.fields().name); },      \
        doc.c_str());                                                                             \
  }
  NOVAPHY_STATE_FIELDS(NOVAPHY_BIND_WHOLE)
#undef NOVAPHY_BIND_WHOLE
}

// Returns forces as rows of T: from a Tensor {n, width} or {steps, n, width}, or a DeviceArray of
// T.
template <class T>
DeviceArray<T> force_rows(const py::object& forces, const char* name, int32_t count) {
  constexpr int32_t kWidth = sizeof(T) / sizeof(float);
  if (py::isinstance<Array>(forces)) return DeviceArray<T>(forces.cast<Array>());
  require(py::isinstance<nova::TensorImpl>(forces), ErrorKind::Type, "rollout, ", name,
          ": expected a Tensor or a DeviceArray, got ", type_name(forces));
  const auto tensor = forces.cast<Tensor>();
  const nova::Shape& shape = tensor.shape();
  require(tensor.dtype() == nova::DType::F32 && (shape.size() == 2 || shape.size() == 3) &&
              shape.back() == kWidth && shape[shape.size() - 2] == count,
          ErrorKind::Value, "rollout, ", name, ": expected float32 {", count, ", ", kWidth,
          "} or {steps, ", count, ", ", kWidth, "}, got ", nova::dtype_name(tensor.dtype()), " ",
          nova::shape_str(shape));
  return DeviceArray<T>(
      Array(DTypeOf<T>::value, static_cast<size_t>(tensor.size()) / kWidth, 1, tensor.range()));
}

// Returns the targets of kinematic particles as rows, from {k, 3} or {steps, k, 3}. The rollout
// checks the number of rows.
DeviceArray<Vec3f> target_rows(const py::object& targets) {
  if (py::isinstance<Array>(targets)) return DeviceArray<Vec3f>(targets.cast<Array>());
  require(py::isinstance<nova::TensorImpl>(targets), ErrorKind::Type,
          "rollout, targets: expected a Tensor or a DeviceArray, got ", type_name(targets));
  const auto tensor = targets.cast<Tensor>();
  const nova::Shape& shape = tensor.shape();
  require(tensor.dtype() == nova::DType::F32 && (shape.size() == 2 || shape.size() == 3) &&
              shape.back() == 3,
          ErrorKind::Value, "rollout, targets: expected float32 {k, 3} or {steps, k, 3}, got ",
          nova::dtype_name(tensor.dtype()), " ", nova::shape_str(shape));
  return DeviceArray<Vec3f>(
      Array(DType::vec3, static_cast<size_t>(tensor.size()) / 3, 1, tensor.range()));
}

// An argument of rollout that replaces an array of the Control: a Tensor or DeviceArray, {n} for
// all steps or {steps, n}.
class ControlRows {
 public:
  ControlRows(const char* name, DeviceArray<float> ControlFields::*member, const py::object& given,
              int32_t steps, int32_t count)
      : name_(name), member_(member) {
    if (given.is_none()) return;
    const bool is_array = py::isinstance<Array>(given);
    require(is_array || py::isinstance<nova::TensorImpl>(given), ErrorKind::Type, "rollout, ", name,
            ": expected a Tensor or a DeviceArray, got ", type_name(given));
    values_ = is_array ? Tensor::view(given.cast<const Array&>()) : given.cast<Tensor>();
    const nova::Shape& shape = values_.shape();
    require(values_.dtype() == nova::DType::F32 &&
                (shape == nova::Shape{count} || shape == nova::Shape{steps, count}),
            ErrorKind::Value, "rollout, ", name, ": expected float32 {", count, "} or {", steps,
            ", ", count, "}, got ", nova::dtype_name(values_.dtype()), " ", nova::shape_str(shape));
    const nova::Tape* const tape = nova::Tape::active();
    carries_ = tape != nullptr && tape->carries_gradient(*values_.range());
  }
  const char* name() const { return name_; }
  bool any() const { return values_.defined(); }
  bool change() const { return any() && values_.ndim() == 2; }
  void put(ControlFields& fields, int32_t step) {
    if (any() && values_.size() != 0)
      fields.*member_ = DeviceArray<float>(
          Array(DType::float32, static_cast<size_t>(values_.shape().back()), 1, row(step)));
  }

 private:
  // Returns the memory of a step's row. If the array requires a gradient, the row is a recorded
  // copy, because a gradient belongs to one memory range. Rows are copied from blocks of 32 rows,
  // so that the backward pass adds a row's gradient to its block, and a block's gradient to the
  // array.
  std::shared_ptr<Range> row(int32_t step) {
    if (!change()) return values_.range();
    constexpr int32_t kBlock = 32;
    if (carries_) {
      if (step % kBlock == 0)
        block_ = nova::slice(values_, 0, step, std::min<int64_t>(kBlock, values_.dim(0) - step));
      return nova::slice(block_, 0, step % kBlock, 1).range();
    }
    const Range& all = *values_.range();
    const size_t bytes = all.bytes() / static_cast<size_t>(values_.dim(0));
    return all.storage().range(all.offset() + static_cast<size_t>(step) * bytes, bytes);
  }

  const char* name_;
  DeviceArray<float> ControlFields::*member_;
  Tensor values_, block_;  // undefined: the argument was not given
  bool carries_ = false;
};

// Returns the control of a rollout whose arrays are replaced by the given ones: one Control, or a
// list with one per step. All other arrays are those of `control`, or of the model.
py::object controls_of(const Model& model, const py::object& control, int32_t steps,
                       std::span<ControlRows> given) {
  const auto any = [](const ControlRows& g) { return g.any(); };
  if (std::none_of(given.begin(), given.end(), any)) return control;
  for (const ControlRows& g : given)
    require(!g.any() || control.is_none() || py::isinstance<Control>(control), ErrorKind::Value,
            "rollout, ", g.name(), ": expected one Control or None beside it, got ",
            type_name(control));
  const ControlFields base =
      control.is_none() ? ControlFields{model.joint_f,
                                        model.joint_target_q,
                                        model.joint_target_qd,
                                        model.joint_act,
                                        model.particle_tri_activation,
                                        model.particle_tet_activation,
                                        model.ctrl}
                        : static_cast<const ControlFields&>(control.cast<const Control&>());
  const auto changes = [](const ControlRows& g) { return g.change(); };
  const int32_t count = std::any_of(given.begin(), given.end(), changes) ? steps : 1;
  if (count == 0) return control;
  py::list controls;
  for (int32_t t = 0; t < count; ++t) {
    Control of_step(model.counts(), model.device(), model.id());
    static_cast<ControlFields&>(of_step) = base;  // handles
    for (ControlRows& g : given) g.put(of_step, t);
    controls.append(py::cast(std::move(of_step)));
  }
  return controls;
}

void rollout(SolverBase& solver, Trajectory& trajectory, const py::object& given_control,
             const Contacts* contacts, float dt, const py::object& forces,
             const py::object& body_forces, const py::object& targets, CollisionPipeline* pipeline,
             int32_t start, const std::optional<int32_t>& stop, const py::object& joint_f,
             const py::object& joint_target_q, const py::object& joint_target_qd,
             const py::object& ctrl) {
  require(stop.value_or(0) >= 0, ErrorKind::Value, "rollout, stop: expected a state from 0 to ",
          trajectory.steps(), " or None, got ", stop.value_or(0));
  RolloutOptions options{
      .pipeline = pipeline, .start = start, .stop = stop.value_or(trajectory.steps())};
  const Model& model = *trajectory.model();
  DeviceArray<Vec3f> rows;
  if (!forces.is_none()) {
    rows = force_rows<Vec3f>(forces, "forces", model.particle_count());
    options.forces = &rows;
  }
  DeviceArray<SpatialVectorf> wrenches;
  if (!body_forces.is_none()) {
    wrenches = force_rows<SpatialVectorf>(body_forces, "body_forces", model.body_count());
    options.body_forces = &wrenches;
  }
  DeviceArray<Vec3f> places;
  if (!targets.is_none()) {
    places = target_rows(targets);
    options.targets = &places;
  }
  const int32_t steps = options.stop - start;
  ControlRows rows_of_controls[] = {
      {"joint_f", &ControlFields::joint_f, joint_f, steps, model.joint_dof_count()},
      {"joint_target_q", &ControlFields::joint_target_q, joint_target_q, steps,
       model.joint_coord_count()},
      {"joint_target_qd", &ControlFields::joint_target_qd, joint_target_qd, steps,
       model.joint_dof_count()},
      {"ctrl", &ControlFields::ctrl, ctrl, steps, model.actuator_count()}};
  const py::object control = controls_of(model, given_control, steps, rows_of_controls);
  const Control* one = nullptr;
  if (py::isinstance<Control>(control)) {
    one = control.cast<const Control*>();
  } else if (!control.is_none()) {
    require(py::isinstance<py::sequence>(control), ErrorKind::Type,
            "rollout, control: expected a Control, a sequence of them or None, got ",
            type_name(control));
    for (const py::handle each : control) {
      require(each.is_none() || py::isinstance<Control>(each), ErrorKind::Type,
              "rollout, control: expected Controls or None, got ", type_name(each));
      options.controls.push_back(each.is_none() ? nullptr : each.cast<const Control*>());
    }
    require(!options.controls.empty(), ErrorKind::Value,
            "rollout, control: expected at least one Control, got an empty sequence");
  }
  {
    const ReleasedGil no_gil;
    solver.rollout(trajectory, one, contacts, dt, options);
  }
  // Trajectory.recompute uses these arguments again, so the trajectory keeps them alive.
  const py::object kept = py::isinstance<py::sequence>(control) ? py::tuple(control) : control;
  py::cast(trajectory).attr("_rollout_of") =
      py::make_tuple(py::cast(&solver), kept, py::cast(contacts), forces, body_forces, targets,
                     py::cast(pipeline));
}

void bind_rollout(py::module_& solvers) {
  const py::object base = solvers.attr("SolverBase");
  base.attr("rollout") = py::cpp_function(
      &rollout, py::name("rollout"), py::is_method(base), py::arg("trajectory"),
      py::arg("control").none(true), py::arg("contacts").none(true), py::arg("dt"), py::kw_only(),
      "forces"_a = py::none(), "body_forces"_a = py::none(), "targets"_a = py::none(),
      "pipeline"_a = py::none(), "start"_a = 0, "stop"_a = py::none(), "joint_f"_a = py::none(),
      "joint_target_q"_a = py::none(), "joint_target_qd"_a = py::none(), "ctrl"_a = py::none(),
      doc::kRollout);
}

// DiffSolverConfig in Python. solver.config is a copy, whose members cannot be assigned, because an
// assignment would have no effect on the solver.
struct Settings : DiffSolverConfig {
  bool of_solver = false;
};
template <class Value>
void set(Settings& settings, const char* name, Value DiffSolverConfig::*member, Value value) {
  if (settings.of_solver)
    throw py::attribute_error(std::string("DiffSolverConfig.") + name +
                              ": the settings of a solver are those that it was made with; make "
                              "another solver");
  settings.*member = value;
}

void add_contact_gradient(py::class_<Settings>& config) {
  config.def_property(
      "contact_gradient",
      [](const Settings& s) { return contact_gradient_name(s.contact_gradient); },
      [](Settings& s, const std::string& name) {
        set(s, "contact_gradient", &DiffSolverConfig::contact_gradient,
            to_contact_gradient("DiffSolverConfig", name));
      },
      doc::kContactGradient);
}

constexpr const char* kGradientInfo = doc::kDiffGradientInfo;

void bind_solver(py::module_& solvers) {
  const DiffSolverConfig d;
  py::class_<Settings> config(solvers, "DiffSolverConfig", "Options of DiffSemiImplicitSolver.");
  config.def(
      py::init([](bool enable_particles, bool enable_particle_contacts, bool enable_tetrahedra,
                  bool enable_triangles, bool enable_springs, bool enable_bending,
                  bool enable_static_contacts, float static_contact_margin, bool enable_rigid,
                  bool enable_rigid_contacts, float angular_damping,
                  const std::string& friction_law, std::optional<float> friction_smoothing,
                  bool enable_joints, float joint_attach_ke, float joint_attach_kd, bool strict,
                  float particle_kf_bound, const std::string& contact_gradient,
                  const std::string& penalty_law) {
        return Settings{
            {.enable_particles = enable_particles,
             .enable_particle_contacts = enable_particle_contacts,
             .enable_tetrahedra = enable_tetrahedra,
             .enable_triangles = enable_triangles,
             .enable_springs = enable_springs,
             .enable_bending = enable_bending,
             .enable_static_contacts = enable_static_contacts,
             .static_contact_margin = static_contact_margin,
             .particle_kf_bound = particle_kf_bound,
             .enable_rigid = enable_rigid,
             .enable_rigid_contacts = enable_rigid_contacts,
             .angular_damping = angular_damping,
             .friction_law = to_friction_law(friction_law),
             .friction_smoothing = friction_smoothing,
             .penalty_law = to_penalty_law(penalty_law),
             .enable_joints = enable_joints,
             .joint_attach_ke = joint_attach_ke,
             .joint_attach_kd = joint_attach_kd,
             .strict = strict,
             .contact_gradient = to_contact_gradient("DiffSolverConfig", contact_gradient)}};
      }),
      py::kw_only(), "enable_particles"_a = d.enable_particles,
      "enable_particle_contacts"_a = d.enable_particle_contacts,
      "enable_tetrahedra"_a = d.enable_tetrahedra, "enable_triangles"_a = d.enable_triangles,
      "enable_springs"_a = d.enable_springs, "enable_bending"_a = d.enable_bending,
      "enable_static_contacts"_a = d.enable_static_contacts,
      "static_contact_margin"_a = d.static_contact_margin, "enable_rigid"_a = d.enable_rigid,
      "enable_rigid_contacts"_a = d.enable_rigid_contacts, "angular_damping"_a = d.angular_damping,
      "friction_law"_a = friction_law_name(d.friction_law), "friction_smoothing"_a = py::none(),
      "enable_joints"_a = d.enable_joints, "joint_attach_ke"_a = d.joint_attach_ke,
      "joint_attach_kd"_a = d.joint_attach_kd, "strict"_a = d.strict,
      "particle_kf_bound"_a = d.particle_kf_bound, "contact_gradient"_a = "auto",
      "penalty_law"_a = "sampled");
#define NOVAPHY_MEMBER(name, doc)                               \
  config.def_property(                                          \
      #name, [](const Settings& s) { return s.name; },          \
      [](Settings& s, decltype(DiffSolverConfig::name) value) { \
        set(s, #name, &DiffSolverConfig::name, value);          \
      },                                                        \
      doc);
  NOVAPHY_MEMBER(enable_particles, "Whether particles move.")
  NOVAPHY_MEMBER(enable_particle_contacts, "Whether contacts of particles act.")
  NOVAPHY_MEMBER(enable_tetrahedra, "Whether tetrahedra act.")
  NOVAPHY_MEMBER(enable_triangles, "Whether triangles act.")
  NOVAPHY_MEMBER(enable_springs, "Whether springs act.")
  NOVAPHY_MEMBER(enable_bending, "Whether bending edges act.")
  NOVAPHY_MEMBER(enable_static_contacts, doc::kStaticContactsOption)
  NOVAPHY_MEMBER(static_contact_margin, "The distance up to which static contacts are found (m).")
  NOVAPHY_MEMBER(particle_kf_bound, doc::kKfBound)
  NOVAPHY_MEMBER(enable_rigid, "Whether bodies move.")
  NOVAPHY_MEMBER(enable_rigid_contacts, doc::kRigidContactsOption)
  NOVAPHY_MEMBER(angular_damping, "The angular damping of bodies (1/s).")
  NOVAPHY_MEMBER(friction_smoothing,
                 "The slip below which the friction law \"huber\" is smooth (m/s); None: 0.1. With "
                 "\"viscous\", which does not use the value, the solver raises ValueError.")
  add_contact_laws(config, [](auto&&... of) { set(of...); });
  NOVAPHY_MEMBER(enable_joints, "Whether joints act, as springs and dampers.")
  NOVAPHY_MEMBER(joint_attach_ke, "The stiffness of the attachments of joints (N/m and N*m/rad).")
  NOVAPHY_MEMBER(joint_attach_kd,
                 "The damping of the attachments of joints (N*s/m). The angular damping is 0.01 "
                 "times this number (N*m*s/rad).")
  add_contact_gradient(config);
  NOVAPHY_MEMBER(strict, "Whether unsupported parts of a model raise an error; False: ignore them.")
#undef NOVAPHY_MEMBER
  add_settings_pickle(config);

  py::class_<DiffSemiImplicitSolver, SolverBase> solver(solvers, "DiffSemiImplicitSolver",
                                                        doc::kDiffSemiImplicit);
  solver
      .def(py::init([](const std::shared_ptr<Model>& model, const Settings* given) {
             return std::make_unique<DiffSemiImplicitSolver>(
                 model, given != nullptr ? DiffSolverConfig(*given) : DiffSolverConfig{});
           }),
           py::arg("model").none(false), "config"_a = py::none(),
           "Makes a solver. config: a DiffSolverConfig; None: the default settings. "
           "NotImplementedError: a part of the model is not supported.")
      .def_property_readonly(
          "config",
          [](const DiffSemiImplicitSolver& s) {
            return Settings{s.config(), true};
          },
          "A copy of the settings of the solver. Assigning a setting raises AttributeError.")
      .def(
          "stable_dt",
          [](const DiffSemiImplicitSolver& s, const SimState& state, const Contacts* contacts) {
            return contacts != nullptr ? s.stable_dt(state, *contacts) : s.stable_dt(state);
          },
          "state"_a, "contacts"_a = py::none(), doc::kDiffStableDt)
      .def(
          "gradient_info",
          [](const DiffSemiImplicitSolver& s) { return to_fields(s.gradient_info()); },
          kGradientInfo)
      .def("clear_gradient_info", &DiffSemiImplicitSolver::clear_gradient_info,
           "Resets the counts of gradient_info.");
  add_fast_step(solver);
}

}  // namespace

void bind_diff(py::module_& m, py::module_& solvers) {
  bind_engine_programs(m);
  bind_views(m);
  bind_operators(m);
  bind_trajectory(m);
  bind_rollout(solvers);
  bind_solver(solvers);
  bind_diff_featherstone(m, solvers);
  bind_push_box(m);
}

}  // namespace novaphy::python
