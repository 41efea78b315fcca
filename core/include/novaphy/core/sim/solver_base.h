// SolverBase: what every solver is.
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

// A solver reads the model's arrays and settings at every step, so edited values act at the next
// one. One thread at a time may use a solver, and what was recorded with it: another one gets
// ErrorKind::Runtime.
class NOVAPHY_CORE_API SolverBase {
 public:
  explicit SolverBase(std::shared_ptr<const Model> model);  // ErrorKind::Value: null
  virtual ~SolverBase();
  SolverBase(const SolverBase&) = delete;
  SolverBase& operator=(const SolverBase&) = delete;

  const std::shared_ptr<const Model>& model() const { return model_; }
  Device device() const { return model_->device(); }

  // Advances state_in by dt (s) into state_out. The forces in state_in act, and afterwards hold
  // those that the solver added; clear them before the next use. `control` null: the model's
  // defaults; `contacts` null: no contact. One state may be given twice: it gets the values that
  // another one would get, by way of a state of the solver. ErrorKind::Value: two states that share
  // memory; dt not in (0, kLongestStep]; a state, control or contacts of another model or device;
  // on the CPU rigid contacts with a normal that is no unit vector.
  // ErrorKind::Runtime: the forces in state_in may not be written (a Trajectory's, but for state
  // 0); one state twice on an active tape, which needs the values of both.
  virtual void step(SimState& state_in, SimState& state_out, const Control* control,
                    const Contacts* contacts, float dt) = 0;
  // The steps of a trajectory: the bits of a loop of step in which every step starts from the
  // forces in trajectory.particle_f, plus those of the options. They are only read. Errors as
  // RolloutInputs, and those of step.
  virtual void rollout(Trajectory& trajectory, const Control* control, const Contacts* contacts,
                       float dt, const RolloutOptions& options = {});
  // False: step may not be called while a capture records.
  virtual bool supports_graph_capture() const { return false; }
  // Says that values of the model were edited behind its arrays' back.
  virtual void notify_model_changed(ModelFlags flags);

 protected:
  // The checks that every step makes; `name` starts the messages. It watches for overflow.
  void check_step(const char* name, const SimState& state_in, const SimState& state_out,
                  const Control* control, const Contacts* contacts, float dt) const;
  // For a step whose states are one: a state of the solver to step into, and the copy of what such
  // a step has written. ErrorKind::Runtime, naming `name`, on an active tape.
  SimState& next_state(const char* name);
  void take_next(SimState& state);
  // Warns, once, of contacts that no slot was left for; `name` starts the message. On devices it
  // looks at steps 1, 2, 4, 8, ... only, since it waits for them, and not while a tape or a capture
  // records.
  void watch_overflow(const char* name, const Contacts& contacts) const;
  // The use of the memory that the solver keeps from call to call.
  ExclusiveUse::Scope use(const char* call) const { return {*in_use_, call, "the solver"}; }
  const std::shared_ptr<ExclusiveUse>& in_use() const { return in_use_; }
  // For solvers whose kinematic particles go where targets say: how many there are, and such a
  // step.
  virtual int32_t target_count() const { return -1; }
  virtual void step_to_targets(SimState& state_in, SimState& state_out, const Control* control,
                               const Contacts* contacts, float dt,
                               const DeviceArray<Vec3f>& targets);

  // What the solver carries from step to step besides the state, which the next step reads and
  // overwrites; without rows: nothing. Rollouts keep it where they keep states.
  virtual Array carried() const { return {}; }

 private:
  std::shared_ptr<const Model> model_;
  std::shared_ptr<ExclusiveUse> in_use_ = std::make_shared<ExclusiveUse>();
  std::unique_ptr<SimState> next_;  // made by the first step whose states are one
  std::array<uint64_t, StateFields::kFieldCount> next_versions_{};
  mutable bool warned_of_overflow_ = false;
  mutable uint64_t overflow_looks_ = 0;
};

}  // namespace novaphy
