// CustomOp: a differentiable operation given as functions, for what no traced kernel can say, e.g.
// the analytic adjoint of an articulated body's step.
#pragma once

#include <functional>
#include <span>
#include <string>
#include <vector>

#include "novaphy/nova/tensor.h"

namespace nova {

// Where the gradient of an input goes.
struct NOVAPHY_NOVA_API InputGradient {
  Tensor grad;       // shaped like the input; undefined: nobody wants it
  bool add = false;  // to what is there; false: the memory holds nothing yet and must be written

  bool wanted() const { return grad.defined(); }
  // Stores or adds, as wanted. Undefined: a contribution of zero. ErrorKind::Value: another size.
  void put(const Tensor& contribution) const;
};

// The functions submit: launches, copies and fills on memory that is there, in the same order at
// every call, and look at no value on the host. So the operation can be recorded into a capture and
// replayed, be deferred, and be run once more between checkpoints. They keep what they use alive.
struct CustomOp {
  std::string name;
  // float32, at most 64 inputs and values together, and 32 outputs. An output overlaps no input.
  std::vector<Tensor> inputs, outputs;
  // Gives the gradients of the inputs, from those of the outputs (undefined where there is none).
  std::function<void(std::span<const Tensor>, std::span<const InputGradient>)> vjp;
  // Computes the outputs again. Without it the operation cannot stand between checkpoints.
  std::function<void()> forward = nullptr;
  // Tangents of the inputs (undefined: zero) to tangents of the outputs, which are written in full.
  // Without it there is no forward derivative.
  std::function<void(std::span<const Tensor>, std::span<const Tensor>)> jvp = nullptr;
  // What vjp reads the values of: inputs, outputs, and other memory, which forward may read too.
  // backward throws when one was changed since.
  std::vector<Tensor> reads = {};
  // Memory besides the outputs that the functions write: scratch.
  std::vector<Tensor> writes = {};
  // False: the functions may look at values on the host, so what was submitted before has to run
  // first. In a capture that raises as everywhere.
  bool submits_only = true;
};

// Gradients of the outputs in (undefined where there is none), gradients of the inputs out
// (likewise).
using BackwardFn = std::function<std::vector<Tensor>(const std::vector<Tensor>&)>;

// From a function that returns the gradients, reads the inputs' values, and may look at the host.
NOVAPHY_NOVA_API CustomOp make_custom_op(std::string name, std::vector<Tensor> inputs,
                                         std::vector<Tensor> outputs, BackwardFn backward);

}  // namespace nova
