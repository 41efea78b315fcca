// Trajectory: the states of a rollout, contiguous in time.
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

// An array that a solver wants for each step of a rollout, besides the states.
struct ScratchSpec {
  DType dtype = DType::float32;
  size_t rows = 0, width = 1;
  bool operator==(const ScratchSpec&) const = default;
};
using StepScratch = std::span<const Array>;  // in the order of the specs

// steps + 1 states of a model. The kept values of each carried array are one allocation, {kept *
// rows}; state(t) is a regular SimState over its part. state(0) starts with the model's initial
// values. Applied arrays (particle_f, body_f) are there once: they act in every step of a rollout,
// and only state 0 can be written through; the others raise. For particles that is 24 bytes per
// particle and kept state, and 24 more for the gradients of all states once a backward ran; where
// elements act, or forces change over time, 12 more of both for the sums.
//
// With a checkpoint interval k only every k-th state and the last one are kept; the k - 1 states in
// between share one memory. backward then runs each stretch between two kept states once more: the
// same bits, about one forward rollout more of time, and memory for steps / k + k states, which is
// least near k = sqrt(steps).
class NOVAPHY_CORE_API Trajectory {
 public:
  // ErrorKind::Value unless steps >= 0 and checkpoint_interval >= 1. 1 keeps all states.
  Trajectory(std::shared_ptr<const Model> model, int32_t steps, bool requires_grad = true,
             int32_t checkpoint_interval = 1);
  Trajectory(const Trajectory&) = delete;
  Trajectory& operator=(const Trajectory&) = delete;

  int32_t steps() const { return steps_; }
  const std::shared_ptr<const Model>& model() const { return model_; }
  // ErrorKind::Index unless 0 <= t <= steps; ErrorKind::Runtime for a state that is not kept.
  SimState& state(int32_t t);
  const SimState& state(int32_t t) const;

  int32_t checkpoint_interval() const { return interval_; }
  bool keeps(int32_t t) const { return t % interval_ == 0 || t == steps_; }
  int32_t kept_count() const { return static_cast<int32_t>(kept_.states.size()); }
  std::string kept_text() const;  // "0, 8, 16, ... and 100"
  // State t, kept or not, once more from the last kept one before it: a copy. What the last rollout
  // got (solver, contacts, controls, forces) must still be there; ErrorKind::Runtime when it did
  // not run these steps, or when the next kept state does not come out again bit by bit, as far as
  // steps write it, because something was changed.
  SimState recompute(int32_t t) const;

  // The whole arrays: carried ones {kept * rows}, time-major; applied ones {rows}.
  const StateFields& fields() const { return kept_.whole; }
  const DeviceArray<Vec3f>& particle_q() const { return kept_.whole.particle_q; }
  const DeviceArray<Vec3f>& particle_qd() const { return kept_.whole.particle_qd; }
  const DeviceArray<Vec3f>& particle_f() const { return kept_.whole.particle_f; }

  // For solvers. State t, also one that is not kept; its values are there until the next stretch.
  SimState& any_state(int32_t t);
  // One set of arrays for each step that backward runs at a time; made anew when the specs differ.
  void reserve_scratch(const std::vector<ScratchSpec>& specs);
  StepScratch scratch(int32_t t) const { return scratch_.sets[static_cast<size_t>(slot(t))]; }
  // Step t of the last rollout, unrecorded.
  using StepFn = std::function<void(int32_t t, const SimState& from, SimState& to)>;
  // What recompute runs: steps [start, stop).
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
  StateFields applied_;  // the arrays of that role
  States kept_, between_;
  struct Scratch {
    std::vector<ScratchSpec> specs;
    std::vector<std::vector<Array>> sets;
  } scratch_;
  int32_t ran_from_ = 0, ran_to_ = 0;
  StepFn step_;
};

// Arrays as the specs say, one set for each of `count` steps, contiguous in time.
NOVAPHY_CORE_API std::vector<std::vector<Array>> make_scratch(const std::vector<ScratchSpec>& specs,
                                                              int32_t count, Device device);

// The smallest checkpoint interval with which the states of a rollout take at most `bytes`.
// ErrorKind::Value, naming the least that is possible, when none does.
NOVAPHY_CORE_API int32_t checkpoint_interval_for(const Model& model, int32_t steps, uint64_t bytes);

}  // namespace novaphy
