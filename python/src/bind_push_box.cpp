// Bindings of the push-box operators: a sphere pushes a box along a line.
#include "nova_types.h"
#include "novaphy/diff/push_box.h"
#include "part_bindings.h"

namespace novaphy::python {

using nova::Tensor;

namespace {

diff::PushBoxConstant to_number(py::handle value, const char* name) {
  if (py::isinstance<nova::TensorImpl>(value)) return value.cast<Tensor>();
  return to_float(value, name);
}

using Operator = std::pair<Tensor, Tensor> (*)(const Tensor&, const Tensor&, const Tensor&,
                                               const Tensor&, const diff::PushBoxParameters&);

void bind_operator(py::module_& m, const char* name, Operator f, const char* doc) {
  m.def(
      name,
      [f](const Tensor& box_x, const Tensor& box_v, const Tensor& pusher_x, const Tensor& pusher_v,
          py::handle mass, py::handle half_extent, py::handle pusher_radius, py::handle ke,
          py::handle kd, py::handle friction, py::handle dt, py::handle softness,
          py::handle friction_velocity, py::handle gravity) {
        const diff::PushBoxParameters parameters = {
            .mass = to_number(mass, "mass"),
            .half_extent = to_number(half_extent, "half_extent"),
            .pusher_radius = to_number(pusher_radius, "pusher_radius"),
            .ke = to_number(ke, "ke"),
            .kd = to_number(kd, "kd"),
            .friction = to_number(friction, "friction"),
            .dt = to_number(dt, "dt"),
            .softness = to_number(softness, "softness"),
            .friction_velocity = to_number(friction_velocity, "friction_velocity"),
            .gravity = to_number(gravity, "gravity")};
        const ReleasedGil released;
        return f(box_x, box_v, pusher_x, pusher_v, parameters);
      },
      "box_x"_a, "box_v"_a, "pusher_x"_a, "pusher_v"_a, "mass"_a, "half_extent"_a,
      "pusher_radius"_a, "ke"_a, "kd"_a, "friction"_a, "dt"_a, py::kw_only(), "softness"_a = 1e-3f,
      "friction_velocity"_a = 1e-2f, "gravity"_a = 9.81f, doc);
}

}  // namespace

void bind_push_box(py::module_& m) {
  bind_operator(
      m, "integrate_push_box_generated", &diff::integrate_push_box_generated,
      "Simulates one step of a box that a sphere pushes along a line to larger x. Returns (box_x, "
      "box_v) {1} (m, m/s) after dt (s), by symplectic Euler.\n\nbox_x, box_v, pusher_x, pusher_v: "
      "positions (m) and velocities (m/s), tensors {1}.\nmass, half_extent, pusher_radius, ke, kd, "
      "friction, dt: kg, m, m, N/m, N s/m, 1 and s; numbers or tensors {1}.\nsoftness, "
      "friction_velocity, gravity: m, m/s and m/s^2; numbers or tensors {1}.\n\nThe contact law is "
      "smooth, without a reaction on the pusher. With z = -(box_x - half_extent - pusher_radius - "
      "pusher_x) / softness and v_s = friction_velocity, the normal force is N = ke softness "
      "softplus(z) + kd sigmoid(z) v_s softplus((pusher_v - box_v) / v_s). The friction force is "
      "-friction mass gravity tanh(box_v / v_s). Gradients are exact for all "
      "inputs.\n\nValueError, with the name of the argument: a wrong shape or device, a number out "
      "of range, or a state that is not finite. Values of tensors are checked on the CPU outside "
      "of captures only.");
  bind_operator(m, "integrate_push_box_rollout_generated",
                &diff::integrate_push_box_rollout_generated,
                "Runs n steps of integrate_push_box_generated as one operation, with the same "
                "bits. pusher_x and pusher_v {n} have a value per step. Returns (box_x, box_v) "
                "{n}, the states after each step. NotImplementedError: another device than the "
                "CPU.");
}

}  // namespace novaphy::python
