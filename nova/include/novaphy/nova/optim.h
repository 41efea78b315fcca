// Optimizers and gradient clipping as kernels. All functions update in place and are never recorded
// on a tape. Only the checks of direct steps on the CPU read values on the host. All functions may
// therefore be captured, and a replay gives the bits of direct calls. Numbers such as rates and
// limits keep their value at capture time. Values that change from step to step (moments, step
// counters) live on the device.
//
// All parameters are float32 of any shape. The gradient of a parameter is param.grad(), which
// counts as zero after zero_grad(). Units: a gradient has the unit of loss / param. A learning rate
// has the unit of param^2 / loss for SGD and of param for Adam.
//
// Errors name the call and the argument, and are thrown before the first write. ErrorKind::Type: a
// tensor that is undefined or not float32. ErrorKind::Value: a parameter without a gradient, a
// wrong shape, another device, no parameters, memory that is given twice, or a number out of range.
#pragma once

#include <vector>

#include "novaphy/nova/tensor.h"

namespace nova {

// ---- updates of one parameter ----

// Computes param -= learning_rate * param.grad. The learning rate is finite.
NOVAPHY_NOVA_API void sgd_update_f32(const Tensor& param, float learning_rate);

// Updates each row p of param {n, 3} with its gradient g and with clipping. A row whose gradient is
// not finite stays unchanged. If g is longer than max_gradient_norm, g is scaled to that length.
// Then p -= learning_rate * g. If p is longer than max_parameter_norm, p is scaled to that length.
// A norm <= 0 switches its clip off.
NOVAPHY_NOVA_API void sgd_update_vec3_clipped_f32(const Tensor& param, float learning_rate,
                                                  float max_parameter_norm,
                                                  float max_gradient_norm);

// Adam (Kingma and Ba, "Adam: A Method for Stochastic Optimization", ICLR 2015, Algorithm 1), value
// by value. Each operation is rounded to float32 in this order, which is Warp's:
//   t += 1
//   m = beta1 * m + (1 - beta1) * g
//   v = beta2 * v + (1 - beta2) * g * g
//   param -= lr * (m / (1 - beta1^t)) / (sqrt(v / (1 - beta2^t)) + eps)
// The moments m and v have the shape of param and are zero before the first update. t {1} float32
// is the number of updates so far. A kernel increments t, so each launch of a captured graph is a
// step. Every call increments its t, so each parameter needs its own. t stops at 2^24 - 1. A t that
// is negative or NaN counts as 0.
// 1 - beta^t is computed from the bits of t by products alone, without pow and without
// cancellation, to a relative error of 2e-6. The result depends on t only.
// lr is finite and >= 0, beta1 and beta2 are in [0, 1), and eps is finite and > 0. A gradient that
// is not finite, or whose square overflows, makes its moments invalid. Clip the gradient first, or
// use the class Adam.
NOVAPHY_NOVA_API void adam_update_f32(const Tensor& param, const Tensor& m, const Tensor& v,
                                      const Tensor& t, float lr, float beta1 = 0.9f,
                                      float beta2 = 0.999f, float eps = 1e-8f);

// ---- clipping ----

// Scales all gradients so that their common Euclidean norm is at most max_norm. The factor is
// PyTorch's min(1, max_norm / (norm + 1e-6)); a factor of 1 keeps every bit. Returns the norm
// before clipping, {1}. The squares are summed in the order of the row-sum rule, one parameter
// after the other, with the same bits for any number of threads. If the norm is not finite, all
// gradients are set to zero, so that the next update has no effect, and the returned norm shows it.
// max_norm > 0; infinity only measures.
NOVAPHY_NOVA_API Tensor clip_grad_norm_(const std::vector<Tensor>& params, float max_norm);
// Limits every value of every gradient to [-v, v], where v > 0. NaN stays NaN.
NOVAPHY_NOVA_API void clip_grad_value_(const std::vector<Tensor>& params, float v);
// Limits every value of param to [lower, upper], where lower <= upper. NaN stays NaN.
NOVAPHY_NOVA_API void clamp_(const Tensor& param, float lower, float upper);

// ---- optimizers of several parameters ----

struct SGDOptions {
  float lr = 1e-3f;           // finite, >= 0
  float momentum = 0.0f;      // finite, >= 0
  float dampening = 0.0f;     // finite
  float weight_decay = 0.0f;  // finite, >= 0
  bool nesterov = false;      // needs momentum > 0 and dampening 0
};
struct AdamOptions {
  float lr = 1e-3f;                    // finite, >= 0
  float beta1 = 0.9f, beta2 = 0.999f;  // in [0, 1)
  float eps = 1e-8f;                   // finite, > 0
};

namespace optim {

// The parameters and the learning rate of an optimizer. The parameters are on one device and share
// no memory.
//
// A step needs finite gradients. A direct step on the CPU throws otherwise. On a device and in
// replays, a step with gradients that are not finite changes nothing and sets a flag, and the next
// check() throws. Direct steps and replays on the CPU, and the accessors of the state, call
// check().
class NOVAPHY_NOVA_API Optimizer {
 public:
  Optimizer(const Optimizer&) = delete;  // a copy would share the state
  Optimizer& operator=(const Optimizer&) = delete;
  const std::vector<Tensor>& params() const { return params_; }
  float lr() const { return lr_; }
  void set_lr(float lr);   // for later steps; a captured graph keeps its rate
  void zero_grad() const;  // zeroes the gradient of every parameter
  // Throws ErrorKind::Runtime if a step since the last call met a gradient that is not finite.
  // Waits for the device. Has no effect in a capture.
  void check() const;

 protected:
  Optimizer(const char* name, std::vector<Tensor> params, float lr);
  ~Optimizer() = default;
  // Checks the gradients before a step. A direct step on the CPU throws if a gradient is not
  // finite. Any other step computes unfit_ when it runs.
  void begin_step() const;
  const char* name_;
  std::vector<Tensor> params_;
  float lr_;
  Tensor unfit_, refused_;  // {1}: unfit_ is 0, or NaN for a step that changes nothing; refused_ is
                            // the number of such steps
};

// Stochastic gradient descent with momentum, in the form of PyTorch and Warp:
//   g += weight_decay * p;  b = momentum * b + (1 - dampening) * g, in the first step b = g;
//   g = nesterov ? g + momentum * b : b;  p -= lr * g
// The buffer b exists only with momentum. Without momentum and weight decay a step is
// sgd_update_f32.
class NOVAPHY_NOVA_API SGD : public Optimizer {
 public:
  explicit SGD(std::vector<Tensor> params, const SGDOptions& options = {});
  // Updates the parameters. ErrorKind::Value: a parameter has no gradient. ErrorKind::Runtime: a
  // gradient is not finite.
  void step() const;
  // The state, which is zero before the first step. Without momentum, b() is empty and t() is
  // undefined.
  const std::vector<Tensor>& b() const { return check(), b_; }  // shapes of the parameters
  const Tensor& t() const { return check(), t_; }               // {1}: number of steps so far

 private:
  SGDOptions options_;
  std::vector<Tensor> b_;
  Tensor t_;
};

// Adam for several parameters: adam_update_f32 with a common t.
class NOVAPHY_NOVA_API Adam : public Optimizer {
 public:
  explicit Adam(std::vector<Tensor> params, const AdamOptions& options = {});
  void step() const;  // errors as for SGD::step
  // The state, which is zero before the first step.
  const std::vector<Tensor>& m() const { return check(), m_; }  // shapes of the parameters
  const std::vector<Tensor>& v() const { return check(), v_; }
  const Tensor& t() const { return check(), t_; }  // {1}: number of steps so far

 private:
  AdamOptions options_;
  std::vector<Tensor> m_, v_;
  Tensor t_, correction_;
};

}  // namespace optim
}  // namespace nova
