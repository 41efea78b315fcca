// Trajectory: the states of a rollout, one after the other in memory.
#pragma once

#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "novaphy/core/export.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"

namespace novaphy {

// The element type and size of an array that a solver needs for each step of a rollout besides the
// states.
struct ScratchSpec {
  DType dtype = DType::float32;
  size_t rows = 0, width = 1;
  bool operator==(const ScratchSpec&) const = default;
};
using StepScratch = std::span<const Array>;  // in the order of the ScratchSpecs

// steps + 1 states of a model. All kept values of a carried array are one allocation {kept * rows};
// state(t) is a SimState that views its part. state(0) starts with the model's initial values.
// Applied arrays (particle_f, body_f) exist once and act in every step of a rollout. Applied arrays
// can be written through state 0 only; a write through another state throws.
//
// Memory per particle and kept state: 24 bytes for the state, and 24 bytes for its gradients after
// a backward pass. With elements or with forces that change over time, the sum of forces takes 12
// bytes more, and its gradient takes another 12 bytes.
//
// With a checkpoint interval k only every k-th state and the last state are kept. The k - 1 states
// between two kept states share one memory. The backward pass recomputes these states with the
// same bits, which costs about the time of one forward rollout. The memory is that of steps / k + k
// states, which is least near k = sqrt(steps).
class NOVAPHY_CORE_API Trajectory {
 public:
  // Throws ErrorKind::Value unless steps >= 0 and checkpoint_interval >= 1. An interval of 1 keeps
  // all states.
  Trajectory(std::shared_ptr<const Model> model, int32_t steps, bool requires_grad = true,
             int32_t checkpoint_interval = 1);
  Trajectory(const Trajectory&) = delete;
  Trajectory& operator=(const Trajectory&) = delete;

  int32_t steps() const { return steps_; }
  const std::shared_ptr<const Model>& model() const { return model_; }
  // Throws ErrorKind::Index unless 0 <= t <= steps, and ErrorKind::Runtime for a state that is not
  // kept.
  SimState& state(int32_t t);
  const SimState& state(int32_t t) const;

  int32_t checkpoint_interval() const { return interval_; }
  bool keeps(int32_t t) const { return t % interval_ == 0 || t == steps_; }
  int32_t stored_count() const { return static_cast<int32_t>(kept_.states.size()); }
  std::string stored_text() const;  // "0, 8, 16, ... and 100"
  // Recomputes state t, kept or not, from the last kept state before it, and returns a copy. The
  // inputs of the last rollout (solver, contacts, controls, forces) must still exist.
  // ErrorKind::Runtime: the last rollout did not run these steps, or the recomputed next kept state
  // differs in a bit because an input has changed.
  SimState recompute(int32_t t) const;

  // The whole arrays: carried arrays have {kept * rows} rows, time-major, and applied arrays
  // {rows}.
  const StateFields& fields() const { return kept_.whole; }
  const DeviceArray<Vec3f>& particle_q() const { return kept_.whole.particle_q; }
  const DeviceArray<Vec3f>& particle_qd() const { return kept_.whole.particle_qd; }
  const DeviceArray<Vec3f>& particle_f() const { return kept_.whole.particle_f; }

  // For solvers: returns state t even if it is not kept. The values stay until the states between
  // another two kept states are computed.
  SimState& any_state(int32_t t);
  // For solvers: allocates the arrays of `specs` for each step between two kept states. A call with
  // other specs replaces the arrays.
  void reserve_scratch(const std::vector<ScratchSpec>& specs);
  StepScratch scratch(int32_t t) const { return scratch_.sets[static_cast<size_t>(slot(t))]; }
  // Runs step t of the last rollout without recording it.
  using StepFn = std::function<void(int32_t t, const SimState& from, SimState& to)>;
  // Sets the steps [start, stop) that recompute can run.
  void set_last_rollout(int32_t start, int32_t stop, StepFn step);

 private:
  struct States {
    StateFields whole;
    std::vector<SimState> states;
  };
  States make_states(int32_t count) const;
  int32_t slot(int32_t t) const { return interval_ == 1 ? t : t % interval_; }

  std::shared_ptr<const Model> model_;
  int32_t steps_ = 0, interval_ = 1;
  StateFields applied_;  // the arrays with FieldRole::Applied
  States kept_, between_;
  struct Scratch {
    std::vector<ScratchSpec> specs;
    std::vector<std::vector<Array>> sets;
  } scratch_;
  int32_t ran_from_ = 0, ran_to_ = 0;
  StepFn step_;
};

// Allocates the arrays of the specs for each of `count` steps. The arrays of one spec are
// contiguous in memory, ordered by step.
NOVAPHY_CORE_API std::vector<std::vector<Array>> make_scratch(const std::vector<ScratchSpec>& specs,
                                                              int32_t count, Device device);

// Returns the smallest checkpoint interval with which the states of a rollout take at most `bytes`.
// Throws ErrorKind::Value with the least possible size if no interval suffices.
NOVAPHY_CORE_API int32_t checkpoint_interval_for(const Model& model, int32_t steps, uint64_t bytes);

}  // namespace novaphy
