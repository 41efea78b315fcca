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
  // Runs the steps of a trajectory. The result has the same bits as a loop of calls of step, where
  // the forces of each step are trajectory.particle_f plus those of the options. The forces are not
  // written. Errors: those of RolloutInputs and of step.
  virtual void rollout(Trajectory& trajectory, const Control* control, const Contacts* contacts,
                       float dt, const RolloutOptions& options = {});
  // Returns whether a capture can record step.
  virtual bool supports_graph_capture() const { return false; }
  // Reports edits of the model that change no array.
  virtual void notify_model_changed(ModelFlags flags);

 protected:
  // Makes the checks that every step needs, and warns of contact overflow. Messages begin with
  // `name`.
  void check_step(const char* name, const SimState& state_in, const SimState& state_out,
                  const Control* control, const Contacts* contacts, float dt) const;
  // For a step whose input and output are the same state: next_state returns an internal state for
  // the result, and take_next copies this result to `state`. ErrorKind::Runtime, with `name`, on an
  // active tape.
  SimState& next_state(const char* name);
  void take_next(SimState& state);
  // Warns once if the search found more contacts than slots; the message begins with `name`. The
  // check waits for a device, so on devices it runs only at steps 1, 2, 4, 8, and so on. While a
  // tape or a capture records, the check is skipped.
  void watch_overflow(const char* name, const Contacts& contacts) const;
  // Claims the solver's memory for the duration of a call (ExclusiveUse).
  ExclusiveUse::Scope use(const char* call) const { return {*in_use_, call, "the solver"}; }
  const std::shared_ptr<ExclusiveUse>& in_use() const { return in_use_; }
  // Kinematic targets: target_count returns the number of particles that targets move (-1: not
  // supported), and step_to_targets is a step that moves these particles to the targets.
  virtual int32_t target_count() const { return -1; }
  virtual void step_to_targets(SimState& state_in, SimState& state_out, const Control* control,
                               const Contacts* contacts, float dt,
                               const DeviceArray<Vec3f>& targets);

  // Returns the memory that the solver carries from step to step besides the state. The next step
  // reads and overwrites this memory. An array without rows means that the solver has none.
  // Rollouts store a copy of the memory with each kept state.
  virtual Array carried() const { return {}; }

 private:
  std::shared_ptr<const Model> model_;
  std::shared_ptr<ExclusiveUse> in_use_ = std::make_shared<ExclusiveUse>();
  std::unique_ptr<SimState> next_;  // made by the first step whose input and output are the same
                                    // state
  std::array<uint64_t, StateFields::kFieldCount> next_versions_{};
  mutable bool warned_of_overflow_ = false;
  mutable uint64_t overflow_checks_ = 0;
};

}  // namespace novaphy
