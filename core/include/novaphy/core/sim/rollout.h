// The inputs of the steps of a rollout.
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

// The interface of an object that finds the contacts of a state, such as CollisionPipeline. This
// library cannot use that class directly, because the collision library depends on this one.
class ContactFinder {
 public:
  virtual ~ContactFinder() = default;
  virtual Contacts contacts() const = 0;  // empty buffers for `collide`
  // `dt` (s) is the length of the step that the contacts are for. The search may leave out rigid
  // contacts that cannot touch within dt. If empty, the contacts are valid for a step of any
  // length.
  virtual void collide(const SimState& state, Contacts& contacts,
                       std::optional<float> soft_contact_margin = {},
                       std::optional<float> dt = {}) = 0;
};

struct RolloutOptions {
  // Forces on the n particles (N, world frame), added to the trajectory's particle_f. The array has
  // n rows for all steps, or n rows for each step of this call, time-major.
  const DeviceArray<Vec3f>* forces = nullptr;
  // Replaces `control` by m controls, each of which acts in an equal share of the steps. A null
  // pointer selects the model's defaults. The number of steps must be a multiple of m.
  std::vector<const Control*> controls = {};
  // Wrenches on the b bodies (N, N m, world frame, about the center of mass), added to the
  // trajectory's body_f. The array has b rows for all steps, or b rows for each step of this call,
  // time-major.
  const DeviceArray<SpatialVectorf>* body_forces = nullptr;
  // Kinematic targets: positions of the k kinematic particles at the end of a step (m, world
  // frame), in the order of their indices. The array has k rows for all steps, or k rows for each
  // step of this call, time-major. ErrorKind::NotImplemented: the solver has no kinematic targets.
  const DeviceArray<Vec3f>* targets = nullptr;
  // Finds new contacts for every step from its state. Replaces the `contacts` of the call.
  ContactFinder* pipeline = nullptr;
  // The rollout runs the steps [start, stop) of the trajectory; a `stop` of -1 means the last step.
  // The states `start` and `stop` must be kept.
  int32_t start = 0, stop = -1;
};

// The checked arguments of a rollout, with access by step.
class NOVAPHY_CORE_API RolloutInputs {
 public:
  // Throws ErrorKind::Value and names the argument: objects of another model, dt not in (0,
  // kLongestStep], forces of another size or device, a number of controls that does not divide the
  // steps, states that do not exist or are not kept, contacts together with a pipeline. `held` is
  // the number of kinematic particles that targets move; -1 means that the solver supports no
  // targets.
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
  // Rows of forces on each particle or body, or rows of targets.
  struct Forces {
    Array rows;           // without rows: no forces
    size_t count = 0;     // number of particles or bodies
    bool change = false;  // whether the rows differ between steps
    int32_t start = 0;
    bool any() const { return rows.rows() != 0; }
    size_t first(int32_t t) const {  // first row of step t
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
