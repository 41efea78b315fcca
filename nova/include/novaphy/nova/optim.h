// Optimizers and gradient clipping as kernels: in place, never recorded on a tape, without a read
// on the host but for what direct steps on the CPU check. So all of it may stand in a
// ScopedCapture, and a launch of the graph gives the bits of the same calls run at once. Numbers
// (rates, limits) are those of the moment of the capture; what changes from step to step (moments,
// step counters) lives on the device.
//
// All parameters are float32, of any shape; a parameter's gradient is param.grad(), which counts as
// zero after zero_grad(). Units: a gradient has those of loss / param, a learning rate for SGD
// those of param^2 / loss, for Adam those of param.
//
// Errors name the call and the argument, and come before anything is written. ErrorKind::Type: a
// tensor that is undefined or not float32. ErrorKind::Value: a parameter without a gradient, a
// wrong shape, another device, no parameters, memory that is given twice, or a number out of the
// ranges below.
#pragma once

#include <vector>

#include "novaphy/nova/tensor.h"

namespace nova {

// ---- updates of one parameter ----

// param -= learning_rate * param.grad. The learning rate is finite.
NOVAPHY_NOVA_API void sgd_update_f32(const Tensor& param, float learning_rate);

// Per row of param {n, 3}: a gradient with a value that is not finite leaves the row unchanged; a
// gradient longer than max_gradient_norm is scaled to it; p -= learning_rate * g; a result longer
// than max_parameter_norm is scaled to it. A norm <= 0 switches that clip off.
NOVAPHY_NOVA_API void sgd_update_vec3_clipped_f32(const Tensor& param, float learning_rate,
                                                  float max_parameter_norm,
                                                  float max_gradient_norm);

// Adam (Kingma and Ba, "Adam: A Method for Stochastic Optimization", ICLR 2015, Algorithm 1), value
// by value, each operation rounded to float32 in this order (Warp's):
//   t += 1
//   m = beta1 * m + (1 - beta1) * g
//   v = beta2 * v + (1 - beta2) * g * g
//   param -= lr * (m / (1 - beta1^t)) / (sqrt(v / (1 - beta2^t)) + eps)
// m, v: the moments, of param's shape, zero before the first update. t {1} float32: the number of
// updates so far, zero before the first; a kernel raises it, so each launch of a captured graph is
// a step. One t per parameter: every call raises it. t stays at 2^24 - 1; a t that is negative or
// NaN counts as 0.
// 1 - beta^t is computed from the bits of t by products alone (no pow, and no difference of two
// numbers near 1), to a relative error of 2e-6; it depends on t only, not on the way there.
// lr finite, >= 0; beta1 and beta2 in [0, 1); eps finite, > 0. A value whose gradient is not
// finite, or whose square overflows, spoils its moments: clip first, or use the class.
NOVAPHY_NOVA_API void adam_update_f32(const Tensor& param, const Tensor& m, const Tensor& v,
                                      const Tensor& t, float lr, float beta1 = 0.9f,
                                      float beta2 = 0.999f, float eps = 1e-8f);

// ---- clipping ----

// Scales all gradients so that the Euclidean norm over all of them together is at most max_norm,
// with PyTorch's factor min(1, max_norm / (norm + 1e-6)); a factor of 1 keeps every bit. Returns
// the norm before that, {1}. The squares are summed in the order of the row-sum rule, one parameter
// after the other: the same bits for any number of threads. A norm that is not finite (a gradient
// is not, or its square overflows) sets all gradients to zero, so that an update after it moves
// nothing by garbage; the norm that is returned tells. max_norm > 0; infinity only measures.
NOVAPHY_NOVA_API Tensor clip_grad_norm_(const std::vector<Tensor>& params, float max_norm);
// Limits every value of every gradient to [-v, v]; NaN stays NaN. v > 0.
NOVAPHY_NOVA_API void clip_grad_value_(const std::vector<Tensor>& params, float v);
// Limits every value of param itself to [lower, upper]; NaN stays NaN. lower <= upper.
NOVAPHY_NOVA_API void clamp_(const Tensor& param, float lower, float upper);

// ---- optimizers of several parameters ----

struct SGDOptions {
  float lr = 1e-3f;           // finite, >= 0
  float momentum = 0.0f;      // finite, >= 0
  float dampening = 0.0f;     // finite
  float weight_decay = 0.0f;  // finite, >= 0
  bool nesterov = false;      // needs a momentum > 0 and no dampening
};
struct AdamOptions {
  float lr = 1e-3f;                    // finite, >= 0
  float beta1 = 0.9f, beta2 = 0.999f;  // in [0, 1)
  float eps = 1e-8f;                   // finite, > 0
};

namespace optim {

// The parameters and the learning rate. The parameters are on one device and share no memory.
//
// A step takes finite gradients only. Called directly on the CPU it throws otherwise. On a device
// and in the replays of a capture it leaves parameters and state as they are and notes that: the
// next check() throws, which direct steps on the CPU, the replays there and the accessors of the
// state begin with.
class NOVAPHY_NOVA_API Optimizer {
 public:
  Optimizer(const Optimizer&) = delete;  // a copy would share the state
  Optimizer& operator=(const Optimizer&) = delete;
  const std::vector<Tensor>& params() const { return params_; }
  float lr() const { return lr_; }
  void set_lr(float lr);   // for steps from now on; a captured graph keeps its own
  void zero_grad() const;  // of every parameter
  // ErrorKind::Runtime where steps since the last call met a gradient that is not finite. Waits for
  // a device; in a capture it does nothing.
  void check() const;

 protected:
  Optimizer(const char* name, std::vector<Tensor> params, float lr);
  ~Optimizer() = default;
  // Before a step: the gradients are finite, or it throws, or unfit_ is NaN when the step runs.
  void begin_step() const;
  const char* name_;
  std::vector<Tensor> params_;
  float lr_;
  Tensor unfit_, refused_;  // {1}: 0, else a step changes nothing; such steps
};

// Stochastic gradient descent with momentum, in PyTorch's and Warp's form:
//   g += weight_decay * p;  b = momentum * b + (1 - dampening) * g, in the first step b = g;
//   g = nesterov ? g + momentum * b : b;  p -= lr * g
// Without momentum there is no b, and without weight decay either a step is sgd_update_f32.
class NOVAPHY_NOVA_API SGD : public Optimizer {
 public:
  explicit SGD(std::vector<Tensor> params, const SGDOptions& options = {});
  // ErrorKind::Value: a parameter has no gradient; ErrorKind::Runtime: one that is not finite.
  void step() const;
  // The state, all zero before the first step; empty and undefined without momentum.
  const std::vector<Tensor>& b() const { return check(), b_; }  // as the parameters
  const Tensor& t() const { return check(), t_; }               // {1}: the steps so far

 private:
  SGDOptions options_;
  std::vector<Tensor> b_;
  Tensor t_;
};

// adam_update_f32 of every parameter, with one t for all.
class NOVAPHY_NOVA_API Adam : public Optimizer {
 public:
  explicit Adam(std::vector<Tensor> params, const AdamOptions& options = {});
  void step() const;  // errors as SGD's
  // The state, all zero before the first step.
  const std::vector<Tensor>& m() const { return check(), m_; }  // as the parameters
  const std::vector<Tensor>& v() const { return check(), v_; }
  const Tensor& t() const { return check(), t_; }  // {1}: the steps so far

 private:
  AdamOptions options_;
  std::vector<Tensor> m_, v_;
  Tensor t_, correction_;
};

}  // namespace optim
}  // namespace nova
