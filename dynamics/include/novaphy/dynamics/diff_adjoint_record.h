// AdjointRecord: what a backward pass tells of its steps, for a debugger of gradients. Compiled
// into novaphy::dynamics where nova is built.
#pragma once

#include <cstdint>
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
    Vec3f point{}, normal{}, impulse{}, adjoint{};  // as ContactNote
    bool held = false;
  };
  // Gradients by positions and by rates: {2 dofs}. Positions are tangents, but raw rows of poses in
  // steps of springs.
  struct Step {
    int64_t number = 0;
    float dt = 0.0f;
    std::vector<float> start;  // D^T p, without what the loss adds at the start of the step
    std::vector<float> end;    // p; empty: not known
    // {2 dofs}: the rates after the step and the accelerations; empty: not known
    std::vector<float> rates;
    bool of_springs = false;        // contacts are springs, which push over several steps
    std::vector<Contact> contacts;  // those that push
    std::vector<float> notes;       // a ContactNote per row, while the adjoint runs
    std::vector<Vec3f> changes;     // of the impulses, by rows of contacts; a tangent fills them
  };

  nova::Tensor loss;
  int64_t pass = 0;  // Tape::passes() after the adjoint
  // The leaves of the tape, and what the adjoint added to their gradients; empty: nothing.
  std::vector<std::pair<nova::Tensor, std::vector<float>>> gradients;
  std::vector<Step> steps;  // in the order of the adjoint: the last one first

  // Returns the gradient that the adjoint computed for a leaf. Null: the tensor is no leaf of the
  // tape, or the adjoint computed no gradient for it.
  const std::vector<float>* gradient(const nova::Tensor& leaf) const;
  // Adds an entry for a step. `of` is the address that identifies the step.
  Step& add(const void* of);

  // The record that adjoints and tangents of this thread fill; null: none.
  static AdjointRecord* current();
  // The entry of a step in the current record; null: the record has no such step.
  static Step* entry_of(const void* step);
  class NOVAPHY_DYNAMICS_API Scope {
   public:
    explicit Scope(AdjointRecord& record);
    ~Scope();
    Scope(const Scope&) = delete;
    Scope& operator=(const Scope&) = delete;
  };

 private:
  std::unordered_map<const void*, size_t> place_;
};

// Runs backward of the tape, with a record that the tape keeps instead of the last one.
// ErrorKind::Runtime: no steps are on the tape; ErrorKind::NotImplemented: steps of a solver
// without a record.
NOVAPHY_DYNAMICS_API void backward_with_record(nova::Tape& tape, const nova::Tensor& loss,
                                               const nova::Tensor& seed);
// The record of the tape's last backward, with the changes of impulses along the unit vector
// against the gradient of its loss by these leaves (empty: by all). The change of a spring leaves
// out what earlier changes of its pair cause, so that the sum over the steps of a pair counts each
// of them once.
// ErrorKind::Runtime: there is no record, or another backward has run behind it.
// ErrorKind::NotImplemented: an operation of the tape has no tangent. Errors of Tape::jvp.
NOVAPHY_DYNAMICS_API std::shared_ptr<const AdjointRecord> adjoint_record(
    nova::Tape& tape, const std::vector<nova::Tensor>& inputs = {});

}  // namespace novaphy
