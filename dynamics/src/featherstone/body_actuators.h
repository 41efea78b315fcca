// The actuators of a model that push bodies, and the model's fluid: their wrenches in a step.
#pragma once

#include <functional>
#include <vector>

#include "actuators.h"
#include "body_actuation_kernels.h"
#include "novaphy/dynamics/featherstone/articulations.h"

namespace novaphy {

// The arrays of the fluid, in the order of fluid_place.
inline std::array<Array, articulation::kFluidInputs> fluid_arrays(const Model& m) {
  return {m.fluid_density, m.fluid_viscosity, m.fluid_wind, m.body_fluid_box};
}

class BodyActuators {
 public:
  // Throws ErrorKind::NotImplemented, with the actuator, if its bodies belong to different
  // articulations.
  explicit BodyActuators(const Model& model);

  int64_t count() const { return articulations_.count(); }
  // The body of an actuator, its reference body, and the nearest common ancestor of both. -1: the
  // world.
  struct Bodies {
    int32_t of[articulation::kPushed];
  };
  const std::vector<Bodies>& bodies() const { return bodies_; }  // a row per actuator
  // Returns a dof in the articulation of each actuator. -1: the actuator pushes no bodies.
  const std::vector<int32_t>& dofs() const { return dofs_; }
  // Writes the forces of the actuators that push bodies into `all`. `number`: as for `actuate`.
  using Number = std::function<articulation::DualFloat(int32_t, int32_t, int32_t)>;
  void forces(const Model& model, const SimState& state, const Number& number,
              std::vector<float>& all) const;
  // Returns the size in floats of the workspace per articulation, for a step with scalars of type
  // T.
  template <class T>
  int64_t stride() const {
    return (body_actuation_bytes<T>(articulations_.max_links(), articulations_.max_dofs()) + 15) /
           16 * 4;
  }
  // The workspace for float steps, which all steps share. The adjoint's memory has 13 numbers per
  // body.
  const DeviceArray<float>& workspace() const { return workspace_; }
  const DeviceArray<float>& adjoint_memory() const { return adjoint_memory_; }
  // Returns the arguments of the kernels. take(array): the numbers of an array as type T. `flows`:
  // whether the fluid acts.
  template <class T, class Take>
  BodyActuationOf<T> arguments(const Model& m, const ActuationArrays& inputs, bool flows,
                               const Array& q, const Array& qd, const DeviceArray<float>& workspace,
                               const Take& take) const {
    const std::array<Array, articulation::kFluidInputs> fluid = fluid_arrays(m);
    return {.rows = Untyped(articulations_.rows()),
            .links = Untyped(articulations_.links()),
            .first = first_,
            .order = order_,
            .pushed = pushed_,
            .axes = m.actuator_axes,
            .state = m.actuator_state,
            .frame = m.actuator_frame,
            .reference = m.actuator_reference,
            .in = each<kPushingInputs>([&](size_t i) {
              return i + articulation::kActuated < articulation::kActuationInputs
                         ? Untyped(inputs[i + articulation::kActuated])
                         : Untyped(m.actuator_wrench);
            }),
            .fluid = each<articulation::kFluidInputs>(
                [&](size_t i) { return flows ? Untyped(fluid[i]) : Untyped(nullptr); }),
            .fluid_frame = m.body_fluid_frame,
            .q = take(q),
            .qd = take(qd),
            .X_p = take(m.joint_X_p),
            .X_c = take(m.joint_X_c),
            .axis = take(m.joint_axis),
            .com = take(m.body_com),
            .workspace = workspace,
            .stride = stride<T>()};
  }

 private:
  Articulations articulations_;
  std::vector<Bodies> bodies_;
  std::vector<int32_t> dofs_;
  DeviceArray<int32_t> first_, order_, pushed_;
  DeviceArray<float> workspace_, adjoint_memory_;
};

struct BodyActuationKernels {
  Kernel<BodyActuationArguments> forward;
  Kernel<BodyActuationVjpArguments> vjp;
  Kernel<BodyActuationJvpArguments> jvp;
};
const BodyActuationKernels& body_actuation_kernels();

}  // namespace novaphy
