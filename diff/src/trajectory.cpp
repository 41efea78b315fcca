#include "novaphy/diff/trajectory.h"

#include "novaphy/core/error.h"

namespace novaphy::diff {

namespace {

// Rows [t*n, (t + 1)*n) of a contiguous array, as an array.
DeviceArray<Vec3f> part(const DeviceArray<Vec3f>& whole, size_t t, size_t n) {
  const size_t bytes = n * sizeof(Vec3f);
  return DeviceArray<Vec3f>(
      Array(DType::vec3, n, 1, whole.range()->storage().range(t * bytes, bytes)));
}

}  // namespace

Trajectory::Trajectory(std::shared_ptr<const Model> model, int32_t steps, bool requires_grad)
    : model_(std::move(model)) {
  require(model_ != nullptr, ErrorKind::Value, "Trajectory, model: expected a model, got none");
  require(steps >= 0, ErrorKind::Value, "Trajectory, steps: expected >= 0, got ", steps);
  const auto n = static_cast<size_t>(model_->particle_count());
  const size_t rows = (static_cast<size_t>(steps) + 1) * n;
  particle_q_ = DeviceArray<Vec3f>(rows, model_->device());
  particle_qd_ = DeviceArray<Vec3f>(rows, model_->device());
  particle_f_ = DeviceArray<Vec3f>(n, model_->device());
  for (size_t t = 0; t <= static_cast<size_t>(steps); ++t) {
    StateFields fields;
    fields.allocate(model_->counts(), model_->device());
    fields.particle_q = part(particle_q_, t, n);
    fields.particle_qd = part(particle_qd_, t, n);
    fields.particle_f = particle_f_;
    states_.emplace_back(*model_, std::move(fields));
    states_.back().requires_grad = requires_grad;
  }
  states_[0].particle_q.assign(model_->particle_q);
  states_[0].particle_qd.assign(model_->particle_qd);
}

const DeviceArray<Vec3f>& Trajectory::total_forces() {
  if (total_force_.empty() && steps() > 0) {
    const auto n = static_cast<size_t>(model_->particle_count());
    const auto count = static_cast<size_t>(steps());
    total_forces_ = DeviceArray<Vec3f>(count * n, model_->device());
    for (size_t t = 0; t < count; ++t) total_force_.push_back(part(total_forces_, t, n));
  }
  return total_forces_;
}
const DeviceArray<Vec3f>& Trajectory::total_force(int32_t t) {
  require(t >= 0 && t < steps(), ErrorKind::Index, "Trajectory.total_force: expected 0 <= t < ",
          steps(), ", got ", t);
  total_forces();
  return total_force_[static_cast<size_t>(t)];
}

SimState& Trajectory::state(int32_t t) {
  require(t >= 0 && t <= steps(), ErrorKind::Index, "Trajectory: expected 0 <= t <= ", steps(),
          ", got ", t);
  return states_[static_cast<size_t>(t)];
}
const SimState& Trajectory::state(int32_t t) const {
  return const_cast<Trajectory*>(this)->state(t);
}

}  // namespace novaphy::diff
