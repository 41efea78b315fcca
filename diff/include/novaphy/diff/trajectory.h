// Trajectory: the states of a rollout, contiguous in time.
#pragma once

#include <memory>
#include <vector>

#include "novaphy/core/sim/model.h"
#include "novaphy/diff/export.h"

namespace novaphy::diff {

// steps + 1 states of a model. Positions and velocities are one allocation each {steps + 1, n, 3};
// state(t) is a regular SimState over its part. state(0) starts with the model's initial values.
// All states share one particle_f {n, 3}: the force that is applied in every step of a rollout. 24
// bytes per particle and step, and 24 more for the gradients of all states once a backward ran;
// where elements act 12 more of both for total_forces.
class NOVAPHY_DIFF_API Trajectory {
 public:
  // ErrorKind::Value unless steps >= 0.
  Trajectory(std::shared_ptr<const Model> model, int32_t steps, bool requires_grad = true);

  int32_t steps() const { return static_cast<int32_t>(states_.size()) - 1; }
  const std::shared_ptr<const Model>& model() const { return model_; }
  SimState& state(int32_t t);  // ErrorKind::Index unless 0 <= t <= steps
  const SimState& state(int32_t t) const;

  // {(steps + 1) * n} rows, time-major.
  const DeviceArray<Vec3f>& particle_q() const { return particle_q_; }
  const DeviceArray<Vec3f>& particle_qd() const { return particle_qd_; }
  const DeviceArray<Vec3f>& particle_f() const { return particle_f_; }  // {n}
  // {steps * n} rows, made when first asked for: the forces on the particles in every step, applied
  // ones and those of elements, as a recorded rollout needs them again for its gradient.
  const DeviceArray<Vec3f>& total_forces();
  const DeviceArray<Vec3f>& total_force(int32_t t);  // {n}, of step t

 private:
  std::shared_ptr<const Model> model_;
  DeviceArray<Vec3f> particle_q_, particle_qd_, particle_f_;
  DeviceArray<Vec3f> total_forces_;
  std::vector<DeviceArray<Vec3f>> total_force_;
  std::vector<SimState> states_;
};

}  // namespace novaphy::diff
