// Inputs of the steps of a rollout.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "novaphy/core/export.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/control.h"
#include "novaphy/core/sim/trajectory.h"

namespace novaphy {

inline constexpr float kLongestStep = 1.0e3f;  // s

// What finds the contacts of a state: a CollisionPipeline, for those who know nothing of collision.
class ContactFinder {
 public:
  virtual ~ContactFinder() = default;
  virtual Contacts contacts() const = 0;  // empty ones, which collide takes
  // `dt` (s): of the step that takes the contacts; rows of rigid contacts that cannot touch within
  // it need not be there. Empty: any step may take them.
  virtual void collide(const SimState& state, Contacts& contacts,
                       std::optional<float> soft_contact_margin = {},
                       std::optional<float> dt = {}) = 0;
};

struct RolloutOptions {
  // Forces on the particles (N, world frame) besides the trajectory's particle_f: n rows that act
  // in every step, or n rows for each step of this call, time-major.
  const DeviceArray<Vec3f>* forces = nullptr;
  // Instead of `control`: m controls (null: the model's defaults), each for a m-th of the steps of
  // this call, which must be a multiple of m.
  std::vector<const Control*> controls = {};
  // Wrenches on the bodies (N, N m, world frame, about the center of mass) besides the trajectory's
  // body_f: b rows, or b rows for each step, as `forces`.
  const DeviceArray<SpatialVectorf>* body_forces = nullptr;
  // Where the particles that the solver holds are at the end of a step (m, world frame), in the
  // order of their indices: k rows for every step, or k rows for each step of this call,
  // time-major. ErrorKind::NotImplemented: the solver moves no kinematic particles.
  const DeviceArray<Vec3f>* targets = nullptr;
  // Finds the contacts of every step anew, from its state, instead of the `contacts` of the call.
  ContactFinder* pipeline = nullptr;
  // Steps [start, stop) of the trajectory; stop = -1: to the end. Both states must be kept.
  int32_t start = 0, stop = -1;
};

// The checked arguments of a rollout, step by step.
class NOVAPHY_CORE_API RolloutInputs {
 public:
  // ErrorKind::Value, naming the argument: objects of another model, dt not in (0, kLongestStep],
  // forces of another size or device, a number of controls that does not divide the steps, states
  // that are not there or not kept, contacts besides a pipeline. `held`: the particles that targets
  // move; -1: none can be given.
  RolloutInputs(const Model& model, const Trajectory& trajectory, const Control* control,
                const Contacts* contacts, float dt, const RolloutOptions& options,
                int32_t held = -1);

  int32_t start() const { return start_; }
  int32_t stop() const { return stop_; }
  int32_t steps() const { return stop_ - start_; }
  float dt() const { return dt_; }
  const Contacts* contacts() const { return contacts_; }
  const Control* control(int32_t t) const {
    return controls_[static_cast<size_t>((t - start_) / steps_per_control_)];
  }
  ContactFinder* pipeline() const { return pipeline_; }
  // Rows that act on each particle or body besides the trajectory's; or targets.
  struct Forces {
    Array rows;           // none: none
    size_t count = 0;     // of particles or bodies
    bool change = false;  // over the steps
    int32_t start = 0;
    bool any() const { return rows.rows() != 0; }
    size_t first(int32_t t) const {  // the row at which those of step t begin
      return change ? static_cast<size_t>(t - start) * count : 0;
    }
  };
  const Forces& forces() const { return forces_; }            // vec3, on particles
  const Forces& targets() const { return targets_; }          // vec3, of kinematic particles
  const Forces& body_forces() const { return body_forces_; }  // spatial_vector, on bodies

 private:
  int32_t start_ = 0, stop_ = 0, steps_per_control_ = 1;
  float dt_ = 0.0f;
  const Contacts* contacts_ = nullptr;
  std::vector<const Control*> controls_;
  ContactFinder* pipeline_ = nullptr;
  Forces forces_, body_forces_, targets_;
};

}  // namespace novaphy
