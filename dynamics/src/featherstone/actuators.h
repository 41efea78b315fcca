// The actuators, the gravity compensation and the fluid of a model. A step reads their results
// instead of the drives and external forces of the model, the control and the state.
#pragma once

#include <array>
#include <memory>
#include <vector>

#include "../step_sources.h"
#include "articulation_kernels.h"
#include "novaphy/core/array_stamp.h"
#include "novaphy/core/device_kernel.h"
#include "novaphy/core/sim/control.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"

namespace novaphy {

// The arrays that actuators read, in the order of ActuationInput. An array without rows is absent.
using ActuationArrays = std::array<Array, articulation::kActuationInputs>;

// The drives of a step, in the order of ActuationInput: joint_f, joint_target_q, joint_target_qd,
// joint_target_ke, joint_target_kd, joint_effort_limit.
using StepDrives = std::array<Array, articulation::kActuated>;
StepDrives drives_of(const Model& model, const Control* control);
inline constexpr int32_t kActuatedPlaces[] = {kAt.joint_f,   kAt.target_q,  kAt.target_qd,
                                              kAt.target_ke, kAt.target_kd, kAt.effort_limit};
// Replaces the drives in `arrays` by `drives`.
void read_instead(NamedStepArrays& arrays, const StepDrives& drives);

// Throws an error that names a control or activation that is not finite. Call this after a failed
// step.
void check_actuator_inputs(const Model& model, const SimState& state, const Control* control,
                           const char* user);

// Throws ErrorKind::NotImplemented if gravity compensation or a fluid acts, because `user` does not
// differentiate them.
void check_no_body_forces(const Model& model, const char* user);

class BodyActuators;

class Actuators {
 public:
  explicit Actuators(const Model& model);

  bool any() const { return any_; }  // whether the model has actuators
  // Returns the wrenches on bodies by actuators and the fluid. Null: no wrenches.
  std::shared_ptr<const BodyActuators> on_bodies() const {
    return pushes_ || flows_ ? on_bodies_ : nullptr;
  }
  // Returns whether gravity compensation or a fluid acts, or its gradient is requested.
  bool lifts() const { return lifts_; }
  bool flows() const { return flows_; }
  bool acts() const { return any_ || lifts_ || flows_; }
  // Checks the actuators again if an array was written. Also finds whether any gravcomp, or the
  // density or viscosity of any fluid, is not 0.
  // ErrorKind::Value: a range whose lower end exceeds its upper end.
  // ErrorKind::NotImplemented, with the actuator: a stiffness or damping would be negative; a servo
  // acts on a degree of freedom whose drive does not have both targets; a servo has a force range
  // with one end only, or has a force range while its degree of freedom has another servo or drive.
  void check(const Model& model, const char* user, bool gradient_by_gravcomp = false,
             bool gradient_by_fluid = false);
  // Returns the coordinate of each degree of freedom, as in Actuation.
  std::vector<int32_t> coordinates() const { return coord_.to_host(); }
  // Returns the arrays in the order of ActuationInput.
  static ActuationArrays inputs(const Model& model, const SimState& state, const Control* control);
  articulation::Actuation arguments(const Model& model, const ActuationArrays& inputs,
                                    float dt) const;

 private:
  void find_forces(const Model& model);
  bool any_ = false, pushes_ = false, lifts_ = false, flows_ = false;
  bool has_gravcomp_ = false, has_fluid_ = false;
  std::shared_ptr<const BodyActuators> on_bodies_;
  DeviceArray<int32_t> first_, order_, coord_;
  std::vector<ArrayStamp> checked_;
};

GravcompInputs gravcomp_inputs(const Model& model, const Array& body_f);

struct ActuationKernels {
  Kernel<ActuationArguments> forward;
  Kernel<ActuationVjpArguments> vjp;
  Kernel<ActuationJvpArguments> jvp;
  Kernel<GravcompArguments> lift;
  Kernel<GravcompGradients> lift_vjp;
  Kernel<GravcompTangents> lift_jvp;
};
const ActuationKernels& actuation_kernels();

// Computes the drives and wrenches of a step outside of tapes. All steps of a solver share its
// memory.
class ActuatedStep {
 public:
  explicit ActuatedStep(const Model& model);
  // Calls Actuators::check, and computes the drives of a step and its wrenches on bodies. On
  // devices the launches also write the activations of `out`. On the host `finish` writes them.
  struct Read {
    StepDrives drives;
    Array body_f;
  };
  Read begin(const Model& model, const SimState& in, const SimState& out, const Control* control,
             float dt, const char* user);
  void finish(const SimState& out) const;

 private:
  Actuators actuators_;
  void push(const Model& model, const SimState& in, const Control* control, Read& read);
  void lift(const Model& model, Read& read);

  bool on_host_;
  std::array<DeviceArray<float>, articulation::kActuationOutputs> memory_;
  DeviceArray<SpatialVectorf> body_f_, pushed_f_;
};

}  // namespace novaphy
