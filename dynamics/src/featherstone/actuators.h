// The actuators of a model and its gravity compensation: what a step reads of them instead of the
// drives and forces of the model, the control and the state.
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

// As ActuationInput has them; arrays of no rows are none.
using ActuationArrays = std::array<Array, articulation::kActuationInputs>;

// The drives of a step: joint_f, joint_target_q, joint_target_qd, joint_target_ke,
// joint_target_kd, joint_effort_limit, as in ActuationInput.
using StepDrives = std::array<Array, articulation::kActuated>;
StepDrives drives_of(const Model& model, const Control* control);
inline constexpr int32_t kActuatedPlaces[] = {kAt.joint_f,   kAt.target_q,  kAt.target_qd,
                                              kAt.target_ke, kAt.target_kd, kAt.effort_limit};
// Puts them in the place of those of the model and the control.
void read_instead(NamedStepArrays& arrays, const StepDrives& drives);

// Of a step that failed: names the control or activation that is not finite.
void check_actuator_inputs(const Model& model, const SimState& state, const Control* control,
                           const char* user);

class BodyActuators;

class Actuators {
 public:
  explicit Actuators(const Model& model);

  bool any() const { return any_; }  // actuators
  // Those that push bodies; null: none does.
  const BodyActuators* on_bodies() const { return on_bodies_.get(); }
  bool lifts() const { return lifts_; }  // some gravcomp is not 0, or its gradient is asked for
  // Looks again where arrays were written, also whether some gravcomp is not 0. ErrorKind::Value: a
  // range in the wrong order. ErrorKind::NotImplemented, naming the actuator: a stiffness or
  // damping that would be negative, a servo of a dof whose drive does not have both targets, a
  // force range of a servo that has only one end, or whose dof has another servo or drive.
  void check(const Model& model, const char* user, bool gradient_by_gravcomp = false);
  // Of the degrees of freedom, as in Actuation.
  std::vector<int32_t> coordinates() const { return coord_.to_host(); }
  // As ActuationInput has them.
  static ActuationArrays inputs(const Model& model, const SimState& state, const Control* control);
  articulation::Actuation arguments(const Model& model, const ActuationArrays& inputs,
                                    float dt) const;

 private:
  bool any_ = false, lifts_ = false, has_gravcomp_ = false;
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

// What the steps of a solver have in common: memory for the drives of a step that no tape records.
class ActuatedStep {
 public:
  explicit ActuatedStep(const Model& model);
  // Actuators::check, and the drives of a step and its wrenches on bodies. On devices by launches,
  // which also write the activations of `out`; on the host they are written by finish.
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
