#include "novaphy/diff/trajectory.h"

#include <algorithm>
#include <cstdint>
#include <cstring>

#include "novaphy/core/error.h"
#include "novaphy/nova/tape.h"

namespace novaphy::diff {

namespace {

// Rows [t*n, (t + 1)*n) of a contiguous array, as an array.
DeviceArray<Vec3f> part(const DeviceArray<Vec3f>& whole, size_t t, size_t n) {
  const size_t bytes = n * sizeof(Vec3f);
  return DeviceArray<Vec3f>(
      Array(DType::vec3, n, 1, whole.range()->storage().range(t * bytes, bytes)));
}

int32_t kept_states(int32_t steps, int32_t interval) {
  return steps / interval + 1 + (steps % interval != 0 ? 1 : 0);
}
int32_t shared_states(int32_t steps, int32_t interval) {
  return steps == 0 ? 0 : std::min(interval, steps) - 1;
}

}  // namespace

Trajectory::Trajectory(std::shared_ptr<const Model> model, int32_t steps, bool requires_grad,
                       int32_t checkpoint_interval)
    : model_(std::move(model)), steps_(steps), interval_(checkpoint_interval) {
  require(model_ != nullptr, ErrorKind::Value, "Trajectory, model: expected a model, got none");
  require(steps >= 0 && steps < INT32_MAX, ErrorKind::Value,
          "Trajectory, steps: expected 0 to 2147483646, got ", steps);
  require(interval_ >= 1, ErrorKind::Value,
          "Trajectory, checkpoint: expected an interval >= 1, got ", interval_);
  const auto n = static_cast<size_t>(model_->particle_count());
  const auto kept = static_cast<size_t>(kept_states(steps, interval_));
  try {
    particle_q_ = DeviceArray<Vec3f>(kept * n, model_->device());
    particle_qd_ = DeviceArray<Vec3f>(kept * n, model_->device());
  } catch (const Error& error) {
    fail(error.kind(), "Trajectory, steps: no memory for ", kept, " states of ", n, " particles (",
         error.what(), "); a checkpoint interval keeps fewer states");
  }
  particle_f_ = DeviceArray<Vec3f>(n, model_->device());
  for (size_t k = 0; k < kept; ++k)
    kept_.push_back(make_state(part(particle_q_, k, n), part(particle_qd_, k, n)));
  for (int32_t k = 0; k < shared_states(steps, interval_); ++k)
    between_.push_back(make_state(DeviceArray<Vec3f>(n, model_->device()),
                                  DeviceArray<Vec3f>(n, model_->device())));
  for (auto* states : {&kept_, &between_})
    for (SimState& state : *states) state.requires_grad = requires_grad;
  kept_[0].particle_q.assign(model_->particle_q);
  kept_[0].particle_qd.assign(model_->particle_qd);
}

SimState Trajectory::make_state(DeviceArray<Vec3f> q, DeviceArray<Vec3f> qd) const {
  StateFields fields;
  fields.allocate(model_->counts(), model_->device());
  fields.particle_q = std::move(q);
  fields.particle_qd = std::move(qd);
  fields.particle_f = particle_f_;
  return SimState(*model_, std::move(fields));
}

const DeviceArray<Vec3f>& Trajectory::total_forces() {
  if (total_force_.empty() && steps() > 0) {
    const auto n = static_cast<size_t>(model_->particle_count());
    const auto count = static_cast<size_t>(interval_ == 1 ? steps_ : std::min(interval_, steps_));
    total_forces_ = DeviceArray<Vec3f>(count * n, model_->device());
    for (size_t t = 0; t < count; ++t) total_force_.push_back(part(total_forces_, t, n));
  }
  return total_forces_;
}
const DeviceArray<Vec3f>& Trajectory::total_force(int32_t t) {
  require(t >= 0 && t < steps(), ErrorKind::Index, "Trajectory.total_force: expected 0 <= t < ",
          steps(), ", got ", t);
  total_forces();
  return total_force_[static_cast<size_t>(interval_ == 1 ? t : t % interval_)];
}

SimState& Trajectory::any_state(int32_t t) {
  if (!keeps(t)) return between_[static_cast<size_t>(t % interval_) - 1];
  return t == steps_ ? kept_.back() : kept_[static_cast<size_t>(t / interval_)];
}

std::string Trajectory::kept_text() const {
  const std::string last = std::to_string(steps_);
  if (interval_ >= steps_) return "0 and " + last;
  if (2 * int64_t{interval_} >= steps_) return "0, " + std::to_string(interval_) + " and " + last;
  return "0, " + std::to_string(interval_) + ", " + std::to_string(2 * interval_) + ", ... and " +
         last;
}

SimState& Trajectory::state(int32_t t) {
  require(t >= 0 && t <= steps(), ErrorKind::Index, "Trajectory: expected 0 <= t <= ", steps(),
          ", got ", t);
  if (!keeps(t)) [[unlikely]]
    fail(ErrorKind::Runtime, "Trajectory: state ", t,
         " is not kept, but those of t = ", kept_text(), " are (checkpoint interval ", interval_,
         "); recompute(", t, ") gives it");
  return any_state(t);
}
const SimState& Trajectory::state(int32_t t) const {
  return const_cast<Trajectory*>(this)->state(t);
}

SimState Trajectory::recompute(int32_t t) const {
  require(t >= 0 && t <= steps(), ErrorKind::Index,
          "Trajectory.recompute: expected 0 <= t <= ", steps(), ", got ", t);
  const nova::NoGrad no_grad;
  const auto n = static_cast<size_t>(model_->particle_count());
  const auto copy_of = [&](const SimState& state) {
    SimState copy = make_state(DeviceArray<Vec3f>(n, model_->device()),
                               DeviceArray<Vec3f>(n, model_->device()));
    copy.particle_q.assign(state.particle_q);
    copy.particle_qd.assign(state.particle_qd);
    return copy;
  };
  if (keeps(t)) return copy_of(state(t));
  require(static_cast<bool>(step_), ErrorKind::Runtime,
          "Trajectory.recompute: there was no rollout yet");
  const int32_t first = t / interval_ * interval_, last = std::min(first + interval_, steps_);
  SimState now = copy_of(state(first)), next = copy_of(now), wanted = copy_of(now);
  for (int32_t k = first; k < last; ++k) {
    step_(now, next);
    std::swap(now, next);
    if (k + 1 != t) continue;
    wanted.particle_q.assign(now.particle_q);
    wanted.particle_qd.assign(now.particle_qd);
  }
  const auto same = [](const DeviceArray<Vec3f>& a, const DeviceArray<Vec3f>& b) {
    const std::vector<Vec3f> x = a.to_host(), y = b.to_host();
    return x.empty() || std::memcmp(x.data(), y.data(), x.size() * sizeof(Vec3f)) == 0;
  };
  require(same(now.particle_q, state(last).particle_q) &&
              same(now.particle_qd, state(last).particle_qd),
          ErrorKind::Runtime, "Trajectory.recompute: running from state ", first,
          " does not lead to the kept state ", last,
          " again; the states, or what the rollout read (model, contacts, control), were changed");
  return wanted;
}

int32_t checkpoint_interval_for(const Model& model, int32_t steps, uint64_t bytes) {
  require(steps >= 0, ErrorKind::Value, "Trajectory, steps: expected >= 0, got ", steps);
  const uint64_t state_bytes = 2 * sizeof(Vec3f) * static_cast<uint64_t>(model.particle_count());
  uint64_t least = UINT64_MAX;
  for (int32_t interval = 1; interval <= std::max(1, steps); ++interval) {
    const auto states =
        static_cast<uint64_t>(kept_states(steps, interval) + shared_states(steps, interval));
    least = std::min(least, states * state_bytes);
    if (states * state_bytes <= bytes) return interval;
  }
  fail(ErrorKind::Value, "Trajectory, checkpoint: the states need at least ", least,
       " bytes, allowed are ", bytes);
}

}  // namespace novaphy::diff
