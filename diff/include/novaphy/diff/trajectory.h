// Trajectory: the states of a rollout, contiguous in time.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "novaphy/core/sim/model.h"
#include "novaphy/diff/export.h"

namespace novaphy::diff {

// steps + 1 states of a model. Positions and velocities are one allocation each {kept, n, 3};
// state(t) is a regular SimState over its part. state(0) starts with the model's initial values.
// All states share one particle_f {n, 3}: the force that is applied in every step of a rollout. 24
// bytes per particle and kept state, and 24 more for the gradients of all states once a backward
// ran; where elements act 12 more of both for total_forces.
//
// With a checkpoint interval k only every k-th state and the last one are kept; the k - 1 states in
// between share one memory. backward then runs each stretch between two kept states once more: the
// same bits, about one forward rollout more of time, and memory for steps / k + k states, which is
// least near k = sqrt(steps).
class NOVAPHY_DIFF_API Trajectory {
 public:
  // ErrorKind::Value unless steps >= 0 and checkpoint_interval >= 1. 1 keeps all states.
  Trajectory(std::shared_ptr<const Model> model, int32_t steps, bool requires_grad = true,
             int32_t checkpoint_interval = 1);
  Trajectory(const Trajectory&) = delete;
  Trajectory& operator=(const Trajectory&) = delete;

  int32_t steps() const { return steps_; }
  const std::shared_ptr<const Model>& model() const { return model_; }
  // ErrorKind::Index unless 0 <= t <= steps; ErrorKind::Runtime for a state that is not kept.
  SimState& state(int32_t t);
  const SimState& state(int32_t t) const;

  int32_t checkpoint_interval() const { return interval_; }
  bool keeps(int32_t t) const { return t % interval_ == 0 || t == steps_; }
  int32_t kept_count() const { return static_cast<int32_t>(kept_.size()); }
  // State t, kept or not, once more from the last kept one before it: a copy. What the last rollout
  // got (solver, contacts, control) must still be there; ErrorKind::Runtime when there was none, or
  // when the next kept state does not come out again bit by bit, because something was changed.
  SimState recompute(int32_t t) const;

  // {kept * n} rows, time-major.
  const DeviceArray<Vec3f>& particle_q() const { return particle_q_; }
  const DeviceArray<Vec3f>& particle_qd() const { return particle_qd_; }
  const DeviceArray<Vec3f>& particle_f() const { return particle_f_; }  // {n}
  // Made when first asked for: the forces on the particles in every step, applied ones and those of
  // elements, as a recorded rollout needs them again for its gradient. {steps * n} rows, or those
  // of one interval.
  const DeviceArray<Vec3f>& total_forces();
  const DeviceArray<Vec3f>& total_force(int32_t t);  // {n}, of step t

 private:
  friend class DiffSemiImplicitSolver;
  // One step of the last rollout, unrecorded.
  using StepFn = std::function<void(const SimState& from, SimState& to)>;

  SimState make_state(DeviceArray<Vec3f> q, DeviceArray<Vec3f> qd) const;
  SimState& any_state(int32_t t);  // kept or shared
  std::string kept_text() const;

  std::shared_ptr<const Model> model_;
  int32_t steps_ = 0, interval_ = 1;
  DeviceArray<Vec3f> particle_q_, particle_qd_, particle_f_;
  DeviceArray<Vec3f> total_forces_;
  std::vector<DeviceArray<Vec3f>> total_force_;
  std::vector<SimState> kept_, between_;
  StepFn step_;
};

// The smallest checkpoint interval with which the states of a rollout take at most `bytes`.
// ErrorKind::Value, naming the least that is possible, when none does.
NOVAPHY_DIFF_API int32_t checkpoint_interval_for(const Model& model, int32_t steps, uint64_t bytes);

}  // namespace novaphy::diff
