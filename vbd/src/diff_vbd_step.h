// One step of DiffSolverVBD as a tape or a capture stores it: inputs, outputs, and derivatives as
// tensors.
#pragma once

#include <array>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "novaphy/dynamics/diff_adjoint_record.h"
#include "novaphy/nova/tape.h"
#include "novaphy/vbd/differentiable_vbd.h"
#include "unsolved_steps.h"

namespace novaphy::diff {

inline nova::Tensor tensor_of(const nova::Operand& operand) {
  return {operand.range, {operand.rows, operand.width}, nova::DType::F32};
}

// ErrorKind::NotImplemented: an array of the model or of `given` carries a gradient, but the step
// has no derivative with respect to this array. The message names the array. `inputs`: the tensors
// with a derivative. Null: no contacts.
void check_other_arrays(const nova::Tape& tape, const Model& model, const Contacts* given,
                        const std::vector<nova::Tensor>& inputs);

struct RecordedStep {
  static constexpr const char* kName = "DiffSolverVBD.step";

  explicit RecordedStep(std::shared_ptr<const Model> of) : model(std::move(of)) {}

  std::shared_ptr<const Model> model;
  std::shared_ptr<DifferentiableVbd> steps;
  std::shared_ptr<const Contacts> contacts;
  std::shared_ptr<std::string> failure;  // of replays: see DiffSolverVBD::gradient_info
  std::shared_ptr<ExclusiveUse> in_use;
  nova::Tensor q, qd, f, targets;  // targets: of all steps of a rollout; undefined: none
  nova::Tensor last;               // previous velocity, for the adaptive guess; else undefined
  size_t first_target = 0, target_count = 0;
  VbdActivations activations;
  DeviceArray<Vec3f> q_out, qd_out;
  float dt = 0.0f;
  int32_t of_rollout = -1;  // index of the step in a rollout; -1: not in a rollout
  int64_t number = 0;       // index of the step in its chain of recorded steps
  StepReport report;
  bool implicit = false, trains_elements = false;
  // The values of the model's scalars at the time of the recording.
  float soft_contact_ke = model->soft_contact_ke, soft_contact_kd = model->soft_contact_kd,
        soft_contact_mu = model->soft_contact_mu;

  // An input with a gradient, and the member of VbdStepDerivatives that holds its derivative.
  struct Input {
    nova::Tensor tensor;
    Array VbdStepDerivatives::*derivative;
    bool is_targets = false;
    // Returns the count of values that the step reads from the tensor.
    size_t size(const RecordedStep& step) const {
      return static_cast<size_t>(is_targets ? 3 * step.target_count : tensor.size());
    }
  };
  enum : size_t { kQ, kQd, kForces, kAlways };  // the first inputs of all steps
  std::vector<Input> differentiable() const;
  // Returns whether the step is in a capture on a device, and materials or rest shapes of elements
  // carry a gradient.
  bool trains(const nova::Tape& tape) const;
  bool on_device() const { return !model->device().is_cpu(); }
  void check_others(const nova::Tape& tape, const Contacts* given) const;

  // Run at once, or in the replays of a capture. Errors name the step of a rollout.
  static void submit_forward(const std::shared_ptr<RecordedStep>& step);
  static void submit_backward(const std::shared_ptr<RecordedStep>& step,
                              std::span<const nova::Tensor> outputs,
                              std::span<const nova::InputGradient> to);
  // ErrorKind::NotImplemented: in a capture on a device.
  static void submit_tangent(const std::shared_ptr<RecordedStep>& step,
                             std::span<const nova::Tensor> tangents,
                             std::span<const nova::Tensor> outputs);

 private:
  void check_numbers() const;
  void check_capture() const;
  VbdStepInputs inputs() const;
  std::vector<nova::Tensor> reads() const;
  void forward();
  // `record`: also those by the state and the forces.
  std::vector<Array> derivatives(std::span<const nova::Tensor> outputs,
                                 std::span<const nova::InputGradient> to,
                                 bool record = false) const;
  // diff_vbd_record.cpp. add_to adds the step to a record, after `values` were computed. held_rows
  // returns the contacts of an entry that the present tangent holds (DifferentiableVbd::tangent).
  // note_changes stores the changes of their impulses.
  void add_to(AdjointRecord& record, std::span<const nova::Tensor> outputs,
              std::span<const Array> values) const;
  std::vector<int32_t> held_rows(const AdjointRecord::Step& entry) const;
  void note_changes(AdjointRecord::Step& entry, std::span<const int32_t> held) const;
  void backward(std::span<const nova::Tensor> outputs,
                std::span<const nova::InputGradient> to) const;
  void add_backward(std::span<const nova::Tensor> outputs,
                    std::span<const nova::InputGradient> to) const;
  // Returns the tangents of positions and velocities after the step.
  std::array<DeviceArray<Vec3f>, 2> tangents(std::span<const nova::Tensor> tangents) const;
  // Adds `run` to a capture on the CPU as host work that reads `reads` and writes `results`.
  void capture(std::vector<nova::Tensor> reads, std::vector<nova::Tensor> results,
               std::function<void()> run) const;
  template <class Run>
  decltype(auto) named(const Run& run) const;
};

}  // namespace novaphy::diff
