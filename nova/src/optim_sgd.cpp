// The class SGD, and code that it shares with Adam.
#include <cmath>

#include "engine_kernels.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"
#include "optim_impl.h"

namespace nova::optim {

using novaphy::require;

Optimizer::Optimizer(const char* name, std::vector<Tensor> params, float lr)
    : name_(name), params_(std::move(params)), lr_(lr) {
  detail::check_params(params_, name_);
  set_lr(lr);
  unfit_ = Tensor({1}, DType::F32, params_[0].device());
  refused_ = Tensor({1}, DType::F32, params_[0].device());
}
void Optimizer::set_lr(float lr) {
  detail::check_rate({name_, "lr"}, lr);
  lr_ = lr;
}
void Optimizer::zero_grad() const {
  for (const Tensor& p : params_) p.zero_grad();
}

namespace {

void check_refused(const char* name, const Tensor& refused, const Tensor& unfit) {
  const bool on_cpu = refused.device().is_cpu();
  const float steps = on_cpu ? *static_cast<const float*>(refused.range()->data()) : refused.item();
  if (steps == 0.0f) return;
  for (const Tensor* flag : {&refused, &unfit}) submit_fill(flag->range(), 0.0f);
  novaphy::fail(ErrorKind::Runtime, name,
                ": steps on a device or in a replay: expected finite "
                "gradients, got one that is not in ",
                steps, " of them, which wrote nothing");
}

// Returns 0 for a finite value, else NaN.
const Kernel& unfit_kernel() {
  static const Kernel kernel =
      make_kernel("not_finite_f32", {{"x", DType::F32, 1, Access::Direct}}, {{"out", 1}},
                  [](TraceContext& c) { return std::vector{c.f32(0) * Real(0.0f)}; });
  return kernel;
}

const Kernel& count_refused_kernel() {
  static const Kernel kernel = make_kernel(
      "count_refused_f32",
      {{"refused", DType::F32, 1, Access::Direct}, {"unfit", DType::F32, 1, Access::Direct}},
      {{"refused", 1}}, [](TraceContext& c) {
        return std::vector{c.f32(0) + select(c.f32(1) == Real(0.0f), Real(0.0f), Real(1.0f))};
      });
  return kernel;
}

// Adds the gradient of weight_decay / 2 * p^2. Without decay the gradient keeps its bits: a sum
// would turn -0 into +0, and would be NaN for a p that is not finite.
Real decayed(const Real& grad, const Real& p, const Real& weight_decay) {
  return select(weight_decay == Real(0.0f), grad, grad + weight_decay * p);
}

const Kernel& sgd_step_kernel() {
  static const Kernel kernel = make_kernel(
      "sgd_step_f32",
      {{"param", DType::F32, 1, Access::Direct},
       {"grad", DType::F32, 1, Access::Direct},
       {"unfit", DType::F32, 1, Access::Uniform}},
      {{"param", 1}}, [](TraceContext& c) {
        const Real p = c.f32(0), next = p - c.param(0) * decayed(c.f32(1), p, c.param(1));
        return std::vector{detail::if_fit(c.f32(2), next, p)};
      });
  return kernel;
}

void update(const Tensor& param, const Tensor& unfit, float lr, float weight_decay) {
  const Operand in[] = {param.flat_operand(), detail::grad_operand(param), unfit.operand()};
  const Param params[] = {lr, weight_decay};
  sgd_step_kernel().launch(param.size(), in, {in, 1}, {.params = params});
}

const Kernel& sgd_momentum_kernel() {
  static const Kernel kernel = make_kernel(
      "sgd_momentum_step_f32",
      {{"param", DType::F32, 1, Access::Direct},
       {"b", DType::F32, 1, Access::Direct},
       {"grad", DType::F32, 1, Access::Direct},
       {"t", DType::F32, 1, Access::Uniform},
       {"unfit", DType::F32, 1, Access::Uniform}},
      {{"param", 1}, {"b", 1}}, [](TraceContext& c) {
        const Real unfit = c.f32(4);
        const Real momentum = c.param(1), dampening = c.param(2);
        const Real g = decayed(c.f32(2), c.f32(0), c.param(3));
        const Real later = momentum * c.f32(1) + (Real(1.0f) - dampening) * g;
        const Real new_b = select(c.f32(3) <= Real(1.0f), g, later);
        const Bool nesterov = c.param_i32(4) != Int(0);
        const Real move = select(nesterov, g + momentum * new_b, new_b);
        return std::vector{detail::if_fit(unfit, c.f32(0) - c.param(0) * move, c.f32(0)),
                           detail::if_fit(unfit, new_b, c.f32(1))};
      });
  return kernel;
}

// t is the number of steps including this one.
void update_with_momentum(const Tensor& param, const Tensor& b, const Tensor& t,
                          const Tensor& unfit, float lr, const SGDOptions& options) {
  const Operand in[] = {param.flat_operand(), b.flat_operand(), detail::grad_operand(param),
                        t.operand(), unfit.operand()};
  const Param params[] = {lr, options.momentum, options.dampening, options.weight_decay,
                          static_cast<int32_t>(options.nesterov)};
  sgd_momentum_kernel().launch(param.size(), in, {in, 2}, {.params = params});
}

const Kernel& step_count_kernel() {
  static const Kernel kernel =
      make_kernel("step_count_f32",
                  {{"t", DType::F32, 1, Access::Direct}, {"unfit", DType::F32, 1, Access::Direct}},
                  {{"t", 1}}, [](TraceContext& c) {
                    const Real t = c.f32(0);
                    return std::vector{detail::if_fit(c.f32(1), to_real(detail::next_count(t)), t)};
                  });
  return kernel;
}

void advance(const Tensor& t, const Tensor& unfit) {
  const Operand in[] = {t.operand(), unfit.operand()};
  step_count_kernel().launch(1, in, {in, 1});
}

}  // namespace

void Optimizer::check() const {
  if (!current_capture()) check_refused(name_, refused_, unfit_);
}

void Optimizer::begin_step() const {
  detail::check_grads(params_, name_);
  if (host_can_read(params_[0].device())) {
    check();
    return detail::check_finite_grads(params_, name_);
  }
  if (OpList* graph = current_capture(); graph && params_[0].device().is_cpu())
    graph->before_launch(refused_.range(), [name = name_, refused = refused_, unfit = unfit_] {
      check_refused(name, refused, unfit);
    });
  const Operand flags[] = {refused_.operand(), unfit_.operand()};
  detail::sum_over_grads(params_, unfit_kernel(), flags[1]);
  count_refused_kernel().launch(1, flags, {flags, 1});
}

SGD::SGD(std::vector<Tensor> params, const SGDOptions& options)
    : Optimizer("SGD", std::move(params), options.lr), options_(options) {
  detail::check_rate({name_, "momentum"}, options.momentum);
  detail::check_rate({name_, "weight_decay"}, options.weight_decay);
  require(std::isfinite(options.dampening), ErrorKind::Value,
          "SGD, dampening: expected a finite number, got ", options.dampening);
  require(!options.nesterov || (options.momentum > 0.0f && options.dampening == 0.0f),
          ErrorKind::Value, "SGD, nesterov: expected a momentum > 0 and dampening 0, got ",
          options.momentum, " and ", options.dampening);
  if (options.momentum == 0.0f) return;
  const Device device = params_[0].device();
  for (const Tensor& p : params_) b_.emplace_back(p.shape(), DType::F32, device);
  t_ = Tensor({1}, DType::F32, device);
}

void SGD::step() const {
  NoGrad no_grad;
  begin_step();
  if (t_.defined()) {
    advance(t_, unfit_);
    for (size_t k = 0; k < params_.size(); ++k)
      update_with_momentum(params_[k], b_[k], t_, unfit_, lr_, options_);
    return;
  }
  for (const Tensor& p : params_) update(p, unfit_, lr_, options_.weight_decay);
}

}  // namespace nova::optim

void nova::detail::add_sgd_kernels(EngineKernels& list) {
  for (const Kernel* k :
       {&optim::sgd_step_kernel(), &optim::sgd_momentum_kernel(), &optim::step_count_kernel(),
        &optim::unfit_kernel(), &optim::count_refused_kernel()})
    list.push_back({*k, {}});
}
