// Tape: records the launches whose inputs carry gradients, and runs their adjoints in reverse
// order.
//
// Rules:
// - A leaf is a range that no operation of the tape writes. Only leaves accumulate gradients over
//   several calls of backward. Every other gradient is unset when backward starts: the first
//   contribution stores, and later contributions add in a fixed order.
// - Operands are held by reference, with their version. If an adjoint would read a value that was
//   overwritten, backward throws and names the operation and the input. Nothing is copied.
// - backward throws for a leaf that was read with different values.
// - Reading a value that another living tape recorded throws.
// - KeepGradients::Leaves does not change the bits of the gradients of leaves. Reading another
//   gradient after backward throws.
// - Kernels are recorded on the thread on which the tape is active.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "novaphy/core/exclusive_use.h"
#include "novaphy/core/recorder.h"
#include "novaphy/nova/custom_op.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/tensor.h"

namespace nova {

namespace detail {
struct MemoryAccess;
}

// The gradients that can be read after backward. Gradients of intermediate values take as much
// memory as the values. With Leaves the tape reuses this memory as soon as possible.
enum class KeepGradients : uint8_t { All, Leaves };

class NOVAPHY_NOVA_API Tape {
 public:
  explicit Tape(KeepGradients keep = KeepGradients::All);
  ~Tape();
  Tape(const Tape&) = delete;
  Tape& operator=(const Tape&) = delete;

  // Makes this tape the active tape of the thread. Throws if another tape is active.
  void begin();
  void end();
  static Tape* active();  // this thread's tape, or null; null inside NoGrad

  // Propagates the gradient of `loss` back to every leaf. An operation of this tape must have
  // written `loss`. Without `seed`, `loss` must have one value. Throws ErrorKind::Value or Runtime,
  // or an error of a custom operation. After an error the gradients of leaves are as before the
  // call. On the CPU, backward warns if a gradient of a leaf is not finite, and names the first
  // operation, input and rollout step where this happens. The search runs only in that case.
  void backward(const Tensor& loss, const Tensor& seed = {});
  // Propagates tangents of leaves forward. Returns for each of `outputs` its derivative in the
  // direction of `tangents`, which has one tangent per input. The tape may be used for backward
  // before and after. Values that a tangent needs must not have changed since they were recorded.
  // ErrorKind::Value: an input that is not a leaf with a gradient, or an output that this tape did
  // not write. ErrorKind::NotImplemented: a custom operation without a tangent.
  std::vector<Tensor> jvp(const std::vector<Tensor>& outputs, const std::vector<Tensor>& inputs,
                          const std::vector<Tensor>& tangents);
  // Returns the leaves that carry a gradient, each as one row of numbers, in the order of first
  // use.
  std::vector<Tensor> leaves() const;
  bool has_leaf(const Tensor& tensor) const;  // whether this leaf was read and carries a gradient
  bool has_tangents() const;                  // whether every operation has a tangent
  void zero();                                // sets all gradients of this tape to zero
  void reset();                               // drops all operations
  size_t size() const;
  // Data about the gradients of recorded operations, which the code that records them adds to the
  // tape. reset() also drops the witnesses.
  struct NOVAPHY_NOVA_API Witness {
    virtual ~Witness();
  };
  void add_witness(std::shared_ptr<const Witness> witness);
  std::span<const std::shared_ptr<const Witness>> witnesses() const;
  int64_t passes() const;  // calls of backward since the last reset
  std::vector<std::string> op_names() const;
  size_t memory_bytes() const;  // size of the records, without states and gradients

  // Records a differentiable operation that is not a kernel, after its outputs were computed.
  // ErrorKind::Type, ErrorKind::Value: see CustomOp. ErrorKind::NotImplemented: an operation
  // without `forward` is recorded between checkpoints. ErrorKind::Runtime: the operation reads a
  // value that carries a gradient and is not an input.
  void record_custom(CustomOp op);
  void record_custom(std::string name, std::vector<Tensor> inputs, std::vector<Tensor> outputs,
                     BackwardFn backward) {
    record_custom(make_custom_op(std::move(name), std::move(inputs), std::move(outputs),
                                 std::move(backward)));
  }

  // Marks a range that was written by an operation that the tape does not record, such as a copy or
  // a step of a forward solver. Using the range as an input throws until a recorded operation
  // writes it. `why` completes the message "input of op: ".
  void mark_untracked(const std::shared_ptr<Range>& range, const char* why);

  // Starts a group of operations that backward recomputes before their adjoints. Values inside of
  // the group may be overwritten afterwards, except inputs from before the group and values that
  // are read after it. A rollout therefore keeps only some of its states (Griewank and Walther,
  // "Algorithm 799: revolve", with a fixed interval). Custom operations in a group need `forward`.
  // `memory`: the guard of memory that the group uses besides its operands. ErrorKind::Runtime:
  // inside of another group.
  void begin_recomputed(const std::shared_ptr<novaphy::ExclusiveUse>& memory = {});
  void end_recomputed();

  // Assigns operations that this thread records to a step of a rollout, for error messages.
  class NOVAPHY_NOVA_API StepScope {
   public:
    explicit StepScope(int32_t step);
    ~StepScope();
    StepScope(const StepScope&) = delete;
    StepScope& operator=(const StepScope&) = delete;

   private:
    Tape* tape_;
  };

  // Functions for Kernel::launch. must_record returns whether an input carries a gradient.
  // check_launch makes the checks before the first write. record_launch records the launch.
  bool must_record(std::span<const Operand> inputs) const;
  // `partly` are the outputs of which the launch writes only some rows.
  void check_launch(const detail::KernelImpl& kernel, std::span<const Operand> inputs,
                    std::span<const Operand> partly) const;
  void record_launch(const std::shared_ptr<detail::KernelImpl>& kernel, int64_t dim,
                     std::span<const Operand> inputs, std::span<const Operand> outputs,
                     const LaunchOptions& options, bool recorded);
  void record_rebuild(const Incidence& incidence);  // records rebuild()
  // Called for launches of hand-written kernels, before the launch raises versions. A group of
  // recomputed operations repeats these launches.
  void record_launch(const novaphy::Launch& launch, std::span<const detail::MemoryAccess> accesses);

  // Functions for launches of hand-written kernels. carries_gradient returns whether the range or
  // an overlapping range carries a gradient. mark_constant marks the value of the range as a
  // constant.
  bool carries_gradient(const Range& range) const;
  void mark_constant(const Range& range);
  // Throws ErrorKind::Runtime if another living tape recorded the value of the range or of an
  // overlapping range, because its gradient would be lost. `input` and `op` are for the message.
  void check_not_of_another(const Range& range, const std::string& op,
                            const std::string& input) const;

 private:
  struct Impl;
  static std::unique_ptr<Impl>& spare();
  std::unique_ptr<Impl> impl_;

 public:
  class ScanBody;  // internal: the recorded body of a scan
};

// Calls begin_recomputed and end_recomputed of the active tape, if one exists and `wanted` is true.
class NOVAPHY_NOVA_API RecomputedScope {
 public:
  explicit RecomputedScope(bool wanted, const std::shared_ptr<novaphy::ExclusiveUse>& memory = {})
      : tape_(wanted ? Tape::active() : nullptr) {
    if (tape_) tape_->begin_recomputed(memory);
  }
  ~RecomputedScope() {
    if (tape_) tape_->end_recomputed();
  }
  RecomputedScope(const RecomputedScope&) = delete;
  RecomputedScope& operator=(const RecomputedScope&) = delete;

 private:
  Tape* tape_;
};

class NOVAPHY_NOVA_API TapeScope {
 public:
  explicit TapeScope(Tape& tape) : tape_(tape) { tape_.begin(); }
  ~TapeScope() { tape_.end(); }
  TapeScope(const TapeScope&) = delete;
  TapeScope& operator=(const TapeScope&) = delete;

 private:
  Tape& tape_;
};

// Stops recording on tapes on this thread for the lifetime of the object.
class NOVAPHY_NOVA_API NoGrad {
 public:
  NoGrad();
  ~NoGrad();
  NoGrad(const NoGrad&) = delete;
  NoGrad& operator=(const NoGrad&) = delete;
};
NOVAPHY_NOVA_API bool grad_enabled();

}  // namespace nova
