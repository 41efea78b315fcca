// AdjointRecord: the gradient and the contact impulses at each step of a backward pass, for a
// debugger of gradients. Compiled into novaphy::dynamics if nova is built.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <unordered_map>
#include <utility>
#include <vector>

#include "novaphy/dynamics/export.h"
#include "novaphy/math/types.h"
#include "novaphy/nova/tape.h"

namespace novaphy {

struct NOVAPHY_DYNAMICS_API AdjointRecord : nova::Tape::Witness {
  struct Contact {
    int32_t row = 0;  // contact row of the step
    int32_t world = 0, shape0 = 0, shape1 = 0;
    Vec3f point{}, normal{}, impulse{}, adjoint{};  // as in ContactNote
    bool held = false;
    // A particle, on which the impulse acts; shape1 is then -1. -1: the impulse acts on shape1.
    int32_t particle = -1;
  };
  // Gradients {2 dofs} of the loss: first by positions, then by velocities. Gradients by joint
  // positions are by tangents, one number per dof. Steps with penalty contacts of bodies have
  // gradients by the entries of the body poses instead.
  struct Step {
    int64_t number = 0;
    float dt = 0.0f;
    std::vector<float> start;  // at the start of the step, without the loss's own term there
    std::vector<float> end;    // at the end of the step; empty: not known
    // {2 dofs}: velocities after the step, then accelerations of the step. Empty: not known.
    std::vector<float> rates;
    bool of_springs = false;        // penalty contacts, which push over several steps
    std::vector<Contact> contacts;  // contacts with an impulse
    std::vector<float> notes;       // a ContactNote per contact row, only while the adjoint runs
    std::vector<Vec3f> changes;     // tangents of the impulses, by contact row
    // By contact row: the tangent of the loss because the times at which the contact begins and
    // ends move (DerivativeOf::Motion), beside adjoint . change. Empty: zeros.
    std::vector<float> moved;
  };

  nova::Tensor loss;
  int64_t pass = 0;  // Tape::passes() after the backward pass
  // The leaves of the tape, each with what this backward pass added to its gradient. Empty:
  // nothing.
  std::vector<std::pair<nova::Tensor, std::vector<float>>> gradients;
  std::vector<Step> steps;  // in the order of the backward pass: the last step first
  // While a tangent runs: whether the force of a contact has the tangent 0, so that later steps do
  // not see its change. Null: no contact.
  std::function<bool(const Contact&)> holds;

  // Returns the gradient that the backward pass computed for a leaf. Null: the tensor is no leaf of
  // the tape, or has no gradient.
  const std::vector<float>* gradient(const nova::Tensor& leaf) const;
  // Adds an entry for a step. `of` is an address that identifies the step.
  Step& add(const void* of);

  // Returns the record that adjoints and tangents of this thread fill. Null: none.
  static AdjointRecord* current();
  // Returns the entry of a step in the current record. Null: no record, or no such step.
  static Step* entry_of(const void* step);
  class NOVAPHY_DYNAMICS_API Scope {
   public:
    explicit Scope(AdjointRecord& record);
    ~Scope();
    Scope(const Scope&) = delete;
    Scope& operator=(const Scope&) = delete;
  };

 private:
  std::unordered_map<const void*, size_t> step_index_;
};

// Runs the tape's backward pass with a new record, which replaces the tape's earlier record.
// ErrorKind::Runtime: the tape has no steps of a differentiable solver.
// ErrorKind::NotImplemented: a solver whose steps fill no record.
NOVAPHY_DYNAMICS_API void backward_with_record(nova::Tape& tape, const nova::Tensor& loss,
                                               const nova::Tensor& seed);
// Returns the record of the tape's last backward pass, and fills `changes`: the tangents of the
// impulses along the unit vector against the gradient of the loss by `inputs`. Empty `inputs`: all
// leaves. For penalty contacts a step's change excludes the effect of earlier changes of the same
// pair, so the sum over the steps counts each change once.
// ErrorKind::Runtime: no record, or a later backward pass without a record.
// ErrorKind::NotImplemented: an operation of the tape has no tangent. Errors of Tape::jvp.
NOVAPHY_DYNAMICS_API std::shared_ptr<const AdjointRecord> adjoint_record(
    nova::Tape& tape, const std::vector<nova::Tensor>& inputs = {});

}  // namespace novaphy
