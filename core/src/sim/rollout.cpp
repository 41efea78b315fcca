#include "novaphy/core/sim/rollout.h"

#include <cmath>

#include "novaphy/core/error.h"

namespace novaphy {

RolloutInputs::RolloutInputs(const Model& model, const Trajectory& trajectory,
                             const Control* control, const Contacts* contacts, float dt,
                             const RolloutOptions& options)
    : start_(options.start),
      stop_(options.stop == -1 ? trajectory.steps() : options.stop),
      dt_(dt),
      contacts_(contacts),
      controls_(options.controls),
      particles_(static_cast<size_t>(model.particle_count())) {
  require(trajectory.model()->id() == model.id(), ErrorKind::Value,
          "rollout, trajectory: it belongs to another model");
  require(std::isfinite(dt) && dt > 0.0f, ErrorKind::Value,
          "rollout, dt: expected a finite time step > 0, got ", dt);
  require(start_ >= 0 && start_ <= stop_ && stop_ <= trajectory.steps(), ErrorKind::Value,
          "rollout, start and stop: expected 0 <= start <= stop <= ", trajectory.steps(), ", got ",
          start_, " and ", stop_);
  for (const int32_t t : {start_, stop_})
    require(trajectory.keeps(t), ErrorKind::Value, "rollout, start and stop: state ", t,
            " is not kept, but those of t = ", trajectory.kept_text(), " are");
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
  if (options.forces == nullptr) return;
  forces_ = *options.forces;
  const size_t all = static_cast<size_t>(steps()) * particles_;
  require(forces_.rows() == particles_ || forces_.rows() == all, ErrorKind::Value,
          "rollout, forces: expected {", particles_, ", 3} or {", steps(), ", ", particles_,
          ", 3}, got ", forces_.rows(), " rows of 3");
  require(forces_.rows() == 0 || forces_.device() == model.device(), ErrorKind::Value,
          "rollout, forces: expected them on ", model.device().str(), ", got them on ",
          forces_.device().str());
  forces_change_ = forces_.rows() != particles_;
}

}  // namespace novaphy
