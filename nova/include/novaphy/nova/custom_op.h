// CustomOp: a differentiable operation given as functions, for operations that a traced kernel
// cannot express. An example is the analytic adjoint of an articulation's step.
#pragma once

#include <functional>
#include <span>
#include <string>
#include <vector>

#include "novaphy/nova/tensor.h"

namespace nova {

// The memory that receives the gradient of an input, or a part of it.
struct NOVAPHY_NOVA_API InputGradient {
  Tensor grad;       // shape of the input; undefined: not requested
  bool add = false;  // true: add to the present values; false: the memory must be overwritten

  bool wanted() const { return grad.defined(); }
  // Stores the contribution, or adds it if `add` is true. An undefined contribution is zero.
  // ErrorKind::Value: another size.
  void put(const Tensor& contribution) const;
};

// The functions must submit the same launches, copies and fills in every call, must not allocate,
// and must not read values on the host. The operation can then be captured and replayed, deferred,
// and recomputed between checkpoints. The functions must keep the objects alive that they use.
struct CustomOp {
  std::string name;
  // float32 tensors. `inputs` and `reads` together have at most 64 entries, and `outputs` has at
  // most 32. An output may not overlap an input.
  std::vector<Tensor> inputs, outputs;
  // Computes the gradients of the inputs from those of the outputs. An output without a gradient is
  // undefined.
  std::function<void(std::span<const Tensor>, std::span<const InputGradient>)> vjp;
  // Recomputes the outputs. If null, the operation cannot be recorded between checkpoints.
  std::function<void()> forward = nullptr;
  // Computes the tangents of the outputs from those of the inputs. The tangents of the outputs are
  // overwritten; an undefined tangent of an input is zero. If null, the operation has no forward
  // derivative.
  std::function<void(std::span<const Tensor>, std::span<const Tensor>)> jvp = nullptr;
  // The tensors whose values vjp reads: inputs, outputs, and other memory, which `forward` may read
  // too. backward throws if a value has changed since the forward pass.
  std::vector<Tensor> reads = {};
  // Scratch memory that the functions write besides the outputs.
  std::vector<Tensor> writes = {};
  // If false, the functions read values on the host, so operations submitted before must run first.
  // Such an operation throws in a capture.
  bool submits_only = true;
};

// Maps the gradients of the outputs to the gradients of the inputs. Missing gradients are
// undefined.
using BackwardFn = std::function<std::vector<Tensor>(const std::vector<Tensor>&)>;

// Makes a custom operation from a function that returns the gradients. The function may read the
// values of the inputs, also on the host.
NOVAPHY_NOVA_API CustomOp make_custom_op(std::string name, std::vector<Tensor> inputs,
                                         std::vector<Tensor> outputs, BackwardFn backward);

}  // namespace nova
