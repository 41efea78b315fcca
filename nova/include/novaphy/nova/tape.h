// Tape: records the launches whose inputs carry gradients, and runs their adjoints in reverse.
//
// Rules:
//  - A leaf is a range that no operation of the tape writes. Only leaves accumulate over calls of
//    backward; every other gradient is unset at its start, the first contribution stores, later
//    ones add in a fixed order.
//  - Operands are held by reference with their version. When an adjoint would read a value that was
//    overwritten since, backward throws and names the operation and the input. Nothing is copied.
//  - A leaf that was read with different values has no gradient of both: backward throws.
//  - A value that another living tape recorded is neither a leaf nor a constant: reading it throws.
//  - A tape that keeps the gradients of leaves only (KeepGradients::Leaves) gives the same bits; to
//    read another gradient afterwards throws.
//  - Kernels run and are recorded on the thread on which the tape is active.
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

// Which gradients can be read after backward. Those of intermediate values take as much memory as
// the values do; a tape that keeps leaves only uses that memory again as soon as it can.
enum class KeepGradients : uint8_t { All, Leaves };

class NOVAPHY_NOVA_API Tape {
 public:
  explicit Tape(KeepGradients keep = KeepGradients::All);
  ~Tape();
  Tape(const Tape&) = delete;
  Tape& operator=(const Tape&) = delete;

  // Makes this the active tape of the thread; throws when another one is active.
  void begin();
  void end();
  static Tape* active();  // of this thread, or null; null inside NoGrad

  // Pulls the gradient of `loss` back to every leaf. `loss` must be written by an operation of this
  // tape. Without `seed` it must hold one value. Throws ErrorKind::Value or Runtime, or what a
  // custom operation threw; the gradients of leaves are then as before the call. On the CPU it
  // warns of gradients of leaves that are not finite, with the operation, its input and the step of
  // the rollout where the first came up, which it looks for only then.
  void backward(const Tensor& loss, const Tensor& seed = {});
  // Pushes tangents of leaves forward: for each of `outputs` its derivative in the direction of
  // `tangents`, one per input, in new memory. The tape may be used for backward before and after.
  // Every operation is reread as backward would: values that a tangent needs must be as recorded.
  // ErrorKind::Value: an input that is no leaf with a gradient, an output that this tape did not
  // write; ErrorKind::NotImplemented: a custom operation that was recorded without a tangent.
  std::vector<Tensor> jvp(const std::vector<Tensor>& outputs, const std::vector<Tensor>& inputs,
                          const std::vector<Tensor>& tangents);
  bool has_leaf(const Tensor& tensor) const;  // that this tape read, and that carries a gradient
  bool has_tangents() const;                  // jvp works for every operation
  void zero();                                // all gradients that this tape touched are zero
  void reset();                               // forgets all operations
  size_t size() const;
  // What the maker of operations says of their gradients. A tape forgets witnesses with operations.
  struct NOVAPHY_NOVA_API Witness {
    virtual ~Witness();
  };
  void add_witness(std::shared_ptr<const Witness> witness);
  std::span<const std::shared_ptr<const Witness>> witnesses() const;
  bool has_gone_back() const;  // backward has run since the last reset
  std::vector<std::string> op_names() const;
  size_t memory_bytes() const;  // of the records themselves (not of states and gradients)

  // A differentiable operation that is no kernel: call it after the outputs were computed.
  // ErrorKind::Type, ErrorKind::Value: see CustomOp; ErrorKind::NotImplemented: between checkpoints
  // without `forward`; ErrorKind::Runtime: it reads a value that carries a gradient and is no
  // input.
  void record_custom(CustomOp op);
  void record_custom(std::string name, std::vector<Tensor> inputs, std::vector<Tensor> outputs,
                     BackwardFn backward) {
    record_custom(make_custom_op(std::move(name), std::move(inputs), std::move(outputs),
                                 std::move(backward)));
  }

  // Says that a recorded value stops in the range: what wrote it is not followed, as a copy, or a
  // forward solver's step. Using it as an input before it is written again, or is the output of a
  // recorded operation, throws. `why` completes "input of op: ".
  void mark_untracked(const std::shared_ptr<Range>& range, const char* why);

  // What is recorded in between may be overwritten afterwards, but for what it reads from before
  // and for what is read of it later: backward runs these operations once more, ahead of their
  // adjoints. So a rollout needs memory for some of its states only (Griewank and Walther,
  // "Algorithm 799: revolve", with a fixed interval). Custom operations need their `forward` there.
  // `memory`, if any, is what they use apart from their operands; backward takes it.
  // ErrorKind::Runtime inside another.
  void begin_recomputed(const std::shared_ptr<novaphy::ExclusiveUse>& memory = {});
  void end_recomputed();

  // While one is alive, what this thread records belongs to a step of a rollout: for messages.
  class NOVAPHY_NOVA_API StepScope {
   public:
    explicit StepScope(int32_t step);
    ~StepScope();
    StepScope(const StepScope&) = delete;
    StepScope& operator=(const StepScope&) = delete;

   private:
    Tape* tape_;
  };

  // For Kernel::launch: whether an input carries a gradient; refusals before anything is written;
  // the record.
  bool must_record(std::span<const Operand> inputs) const;
  // `partly`: outputs that are written in part.
  void check_launch(const detail::KernelImpl& kernel, std::span<const Operand> inputs,
                    std::span<const Operand> partly) const;
  void record_launch(const std::shared_ptr<detail::KernelImpl>& kernel, int64_t dim,
                     std::span<const Operand> inputs, std::span<const Operand> outputs,
                     const LaunchOptions& options, bool recorded);
  void record_rebuild(const Incidence& incidence);  // for rebuild()
  // For launches that are no Kernels, before they are noted as writes: a group of recomputed
  // operations runs them once more.
  void record_launch(const novaphy::Launch& launch, std::span<const detail::MemoryAccess> accesses);

  // For launches that are no Kernels: whether the range, or one that shares bytes with it, carries
  // a gradient; and that it now holds a constant.
  bool carries_gradient(const Range& range) const;
  void mark_constant(const Range& range);
  // ErrorKind::Runtime where the value of the range, or of one that shares bytes with it, is one
  // that another living tape recorded: its gradient would stop here. `input`, `op`: for the
  // message.
  void check_not_of_another(const Range& range, const std::string& op,
                            const std::string& input) const;

 private:
  struct Impl;
  static std::unique_ptr<Impl>& spare();
  std::unique_ptr<Impl> impl_;
};

// begin_recomputed and end_recomputed of the active tape, if there is one and it is wanted.
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

// While one is alive nothing of this thread is recorded on a tape.
class NOVAPHY_NOVA_API NoGrad {
 public:
  NoGrad();
  ~NoGrad();
  NoGrad(const NoGrad&) = delete;
  NoGrad& operator=(const NoGrad&) = delete;
};
NOVAPHY_NOVA_API bool grad_enabled();

}  // namespace nova
