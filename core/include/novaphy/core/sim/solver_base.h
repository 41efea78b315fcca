// SolverBase: the common base class of all solvers.
#pragma once

#include <array>
#include <cstdint>
#include <memory>

#include "novaphy/core/exclusive_use.h"
#include "novaphy/core/export.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/control.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/rollout.h"
#include "novaphy/core/sim/sim_state.h"

namespace novaphy {

// A solver reads the model's arrays and settings at every step, so an edited value acts in the next
// step. Only one thread at a time may use a solver or a recording of it. A second thread gets
// ErrorKind::Runtime.
class NOVAPHY_CORE_API SolverBase {
 public:
  explicit SolverBase(std::shared_ptr<const Model> model);  // ErrorKind::Value: null
  virtual ~SolverBase();
  SolverBase(const SolverBase&) = delete;
  SolverBase& operator=(const SolverBase&) = delete;

  const std::shared_ptr<const Model>& model() const { return model_; }
  Device device() const { return model_->device(); }

  // Advances state_in by dt (s) into state_out. The forces in state_in act in the step, and the
  // solver adds its own forces to them; clear them before the next use. Null `control`: the model's
  // defaults. Null `contacts`: no contacts. Both states may be the same object: the step then goes
  // through a state of the solver, with the same result.
  //   ErrorKind::Value    two states that share memory; dt not in (0, kLongestStep]; a state, a
  //                       control or contacts of another model or device; on the CPU, a contact
  //                       normal without unit length
  //   ErrorKind::Runtime  read-only forces in state_in (states of a Trajectory other than state 0);
  //                       the same state twice on an active tape, which needs the values of both
  virtual void step(SimState& state_in, SimState& state_out, const Control* control,
                    const Contacts* contacts, float dt) = 0;
  // Runs the steps of a trajectory. The result has the bits of a loop over step in which every step
  // starts from the forces in trajectory.particle_f plus those of the options. The forces are only
  // read. Errors: those of RolloutInputs and of step.
  virtual void rollout(Trajectory& trajectory, const Control* control, const Contacts* contacts,
                       float dt, const RolloutOptions& options = {});
  // Returns whether a capture can record step.
  virtual bool supports_graph_capture() const { return false; }
  // Reports edits of the model that did not go through its arrays.
  virtual void notify_model_changed(ModelFlags flags);

 protected:
  // Makes the checks that every step needs. Messages begin with `name`. Also watches for contact
  // overflow.
  void check_step(const char* name, const SimState& state_in, const SimState& state_out,
                  const Control* control, const Contacts* contacts, float dt) const;
  // For a step whose input and output are the same state: next_state returns a state of the solver
  // to step into, and take_next copies the result. ErrorKind::Runtime, with `name`, on an active
  // tape.
  SimState& next_state(const char* name);
  void take_next(SimState& state);
  // Warns once if the search found more contacts than slots; the message begins with `name`. The
  // check waits for a device, so on devices it runs only at steps 1, 2, 4, 8, and so on. The check
  // is skipped while a tape or a capture records.
  void watch_overflow(const char* name, const Contacts& contacts) const;
  // Holds the solver's memory for the duration of a call.
  ExclusiveUse::Scope use(const char* call) const { return {*in_use_, call, "the solver"}; }
  const std::shared_ptr<ExclusiveUse>& in_use() const { return in_use_; }
  // Kinematic targets: the number of particles that targets move (-1: not supported), and a step
  // that moves them to the targets.
  virtual int32_t target_count() const { return -1; }
  virtual void step_to_targets(SimState& state_in, SimState& state_out, const Control* control,
                               const Contacts* contacts, float dt,
                               const DeviceArray<Vec3f>& targets);

  // Returns the memory that the solver carries from step to step besides the state. The next step
  // reads and overwrites it. An array without rows means none. Rollouts keep a copy with each kept
  // state.
  virtual Array carried() const { return {}; }

 private:
  std::shared_ptr<const Model> model_;
  std::shared_ptr<ExclusiveUse> in_use_ = std::make_shared<ExclusiveUse>();
  std::unique_ptr<SimState> next_;  // made by the first step with the same state twice
  std::array<uint64_t, StateFields::kFieldCount> next_versions_{};
  mutable bool warned_of_overflow_ = false;
  mutable uint64_t overflow_looks_ = 0;
};

}  // namespace novaphy
