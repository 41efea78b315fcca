#include "novaphy/core/sim/rollout.h"

#include <cmath>

#include "novaphy/core/error.h"

namespace novaphy {
namespace {

RolloutInputs::Forces checked_forces(const Array* given, const char* name, int32_t count,
                                     int32_t width, int32_t start, int32_t steps, Device device) {
  RolloutInputs::Forces f;
  f.count = static_cast<size_t>(count);
  f.start = start;
  if (given == nullptr) return f;
  f.rows = *given;
  const size_t rows = given->rows(), all = static_cast<size_t>(steps) * f.count;
  require(rows == f.count || rows == all, ErrorKind::Value, "rollout, ", name, ": expected {",
          count, ", ", width, "} or {", steps, ", ", count, ", ", width, "}, got ", rows,
          " rows of ", width);
  require(rows == 0 || given->device() == device, ErrorKind::Value, "rollout, ", name,
          ": expected them on ", device.str(), ", got them on ", given->device().str());
  f.change = rows != f.count;
  return f;
}

}  // namespace

RolloutInputs::RolloutInputs(const Model& model, const Trajectory& trajectory,
                             const Control* control, const Contacts* contacts, float dt,
                             const RolloutOptions& options, int32_t held)
    : start_(options.start),
      stop_(options.stop == -1 ? trajectory.steps() : options.stop),
      dt_(dt),
      contacts_(contacts),
      controls_(options.controls),
      pipeline_(options.pipeline) {
  require(trajectory.model()->id() == model.id(), ErrorKind::Value,
          "rollout, trajectory: it belongs to another model");
  require(dt > 0.0f && dt <= kLongestStep, ErrorKind::Value,
          "rollout, dt: expected a finite time step > 0 and at most ", kLongestStep, " s, got ",
          dt);
  require(start_ >= 0 && start_ <= stop_ && stop_ <= trajectory.steps(), ErrorKind::Value,
          "rollout, start and stop: expected 0 <= start <= stop <= ", trajectory.steps(), ", got ",
          start_, " and ", stop_);
  for (const int32_t t : {start_, stop_})
    require(trajectory.keeps(t), ErrorKind::Value, "rollout, start and stop: state ", t,
            " is not kept, but those of t = ", trajectory.stored_text(), " are");
  require(controls_.empty() || control == nullptr, ErrorKind::Value,
          "rollout, controls: expected none besides control");
  if (controls_.empty()) controls_ = {control};
  const auto count = static_cast<int32_t>(controls_.size());
  require(steps() % count == 0, ErrorKind::Value,
          "rollout, control: expected a number of controls that divides the ", steps(),
          " steps, got ", count);
  if (steps() > 0) steps_per_control_ = steps() / count;
  for (const Control* c : controls_)
    require(c == nullptr || c->model_id() == model.id(), ErrorKind::Value,
            "rollout, control: it belongs to another model");
  require(contacts == nullptr || contacts->model_id() == model.id(), ErrorKind::Value,
          "rollout, contacts: they belong to another model");
  require(contacts == nullptr || pipeline_ == nullptr, ErrorKind::Value,
          "rollout, contacts: expected none besides pipeline, which finds those of every step");
  const int32_t particles = model.particle_count(), bodies = model.body_count();
  forces_ = checked_forces(options.forces, "forces", particles, 3, start_, steps(), model.device());
  require(options.targets == nullptr || held >= 0, ErrorKind::NotImplemented,
          "rollout, targets: expected none, this solver moves no kinematic particles");
  targets_ = checked_forces(options.targets, "targets", held, 3, start_, steps(), model.device());
  body_forces_ = checked_forces(options.body_forces, "body_forces", bodies, 6, start_, steps(),
                                model.device());
}

}  // namespace novaphy
