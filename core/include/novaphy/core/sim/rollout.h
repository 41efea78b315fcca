// What acts in the steps of a rollout.
#pragma once

#include <cstdint>
#include <vector>

#include "novaphy/core/export.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/control.h"
#include "novaphy/core/sim/trajectory.h"

namespace novaphy {

struct RolloutOptions {
  // Forces on the particles (N, world frame) besides the trajectory's particle_f: n rows that act
  // in every step, or n rows for each step of this call, time-major.
  const DeviceArray<Vec3f>* forces = nullptr;
  // Instead of `control`: m controls (null: the model's defaults), each for a m-th of the steps of
  // this call, which must be a multiple of m.
  std::vector<const Control*> controls = {};
  // Steps [start, stop) of the trajectory; stop = -1: to the end. Both states must be kept.
  int32_t start = 0, stop = -1;
};

// The checked arguments of a rollout, step by step.
class NOVAPHY_CORE_API RolloutInputs {
 public:
  // ErrorKind::Value, naming the argument: objects of another model, dt not finite or <= 0, forces
  // of another size or device, a number of controls that does not divide the steps, states that are
  // not there or not kept.
  RolloutInputs(const Model& model, const Trajectory& trajectory, const Control* control,
                const Contacts* contacts, float dt, const RolloutOptions& options);

  int32_t start() const { return start_; }
  int32_t stop() const { return stop_; }
  int32_t steps() const { return stop_ - start_; }
  float dt() const { return dt_; }
  const Contacts* contacts() const { return contacts_; }
  const Control* control(int32_t t) const {
    return controls_[static_cast<size_t>((t - start_) / steps_per_control_)];
  }
  const DeviceArray<Vec3f>& forces() const { return forces_; }  // no rows: none
  bool forces_change() const { return forces_change_; }         // over the steps
  // The row of forces at which those of step t begin.
  size_t first_force(int32_t t) const {
    return forces_change_ ? static_cast<size_t>(t - start_) * particles_ : 0;
  }

 private:
  int32_t start_ = 0, stop_ = 0, steps_per_control_ = 1;
  float dt_ = 0.0f;
  const Contacts* contacts_ = nullptr;
  std::vector<const Control*> controls_;
  DeviceArray<Vec3f> forces_;
  bool forces_change_ = false;
  size_t particles_ = 0;
};

}  // namespace novaphy
